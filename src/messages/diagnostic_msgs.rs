//! `diagnostic_msgs`.

use super::definition::messages;
use super::std_msgs::Header;

messages! { "diagnostic_msgs":
    KeyValue { key: String, value: String }
    DiagnosticStatus { level: i8, name: String, message: String, hardware_id: String, values: Vec<KeyValue> }
    DiagnosticArray { header: Header, status: Vec<DiagnosticStatus> }
}

#[allow(missing_docs)] // values of `level`, named as in the definition
impl DiagnosticStatus {
    pub const OK: i8 = 0;
    pub const WARN: i8 = 1;
    pub const ERROR: i8 = 2;
}
