//! The README's table of parameters is the one the knobs make. `UPDATE_GOLDEN=1 cargo test --test offline readme` renews it.

use std::fs;
use std::path::Path;

use anytime_scan_matcher::config::Config;

const BEGIN: &str = "<!-- parameters: begin (generated, see tests/offline/readme.rs) -->\n";
const END: &str = "<!-- parameters: end -->";

#[test]
fn the_table_of_parameters_is_fresh() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("README.md");
    let readme = fs::read_to_string(&path).unwrap();
    let (before, rest) = readme.split_once(BEGIN).unwrap();
    let (found, after) = rest.split_once(END).unwrap();
    let expected = Config::default().markdown_table();
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        fs::write(&path, [before, BEGIN, &expected, END, after].concat()).unwrap();
    } else {
        assert_eq!(found, expected, "renew the table: UPDATE_GOLDEN=1 cargo test --test offline readme");
    }
}
