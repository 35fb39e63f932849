//! An iteration limit instead of a time budget: how matchers without contracts are sped up.

use super::Terms;

pub(super) fn terms(count: u32) -> Terms {
    Terms { max_iterations: Some(count), ..Terms::default() }
}
