//! Tells rosrust's code generator where the message definitions are: in `msg/`, whatever ROS there is on this machine, and wherever
//! cargo is called from.

use std::env;
use std::path::Path;

fn main() {
    println!("cargo::rerun-if-changed=msg");
    let msg = Path::new(&env::var("CARGO_MANIFEST_DIR").unwrap_or_default()).join("msg");
    println!("cargo::rustc-env=ROSRUST_MSG_PATH={}", msg.display());
    // The other place that it would look in is shut.
    println!("cargo::rustc-env=CMAKE_PREFIX_PATH={}", msg.join(".no-ros-installation").display());
}
