//! A limit of the work instead of one of the time: how matchers without contracts are made to hurry.

use super::Terms;

pub(super) fn terms(count: u32) -> Terms {
    Terms { max_iterations: Some(count), ..Terms::default() }
}
