//! No contract: every answer runs to completion.

use super::Terms;

pub(super) fn terms() -> Terms {
    Terms::default()
}
