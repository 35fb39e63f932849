//! The architecture of `src/lib.rs`, held against the imports: a module uses only modules of the layers below its own.

use std::fs;
use std::path::{Path, PathBuf};

/// From the bottom up. Modules of one layer do not know each other.
const LAYERS: [&[&str]; 13] = [
    &["time", "geometry", "quantile", "parallel", "output", "text_table"],
    &["knobs", "map"],
    &["messages", "raycasting"],
    &["scan", "transforms", "shared_memory"],
    &["matching", "simulation", "evaluation", "cloud"],
    &["anytime"],
    &["odometry", "io", "control"],
    &["localization", "mapping"],
    &["config"],
    &["app"],
    &["replay", "ros"],
    &["profile"],
    &["drive"],
];

fn rust_files(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            files.extend(rust_files(&path));
        } else if path.extension().is_some_and(|e| e == "rs") {
            files.push(path);
        }
    }
    files
}

fn layer(module: &str) -> usize {
    LAYERS
        .iter()
        .position(|layer| layer.contains(&module))
        .unwrap_or_else(|| panic!("{module} is in no layer: add it to tests/offline/layers.rs"))
}

/// Names after `crate::` in code, comments left out.
fn imports(text: &str) -> Vec<String> {
    let code = text.lines().filter(|line| !line.trim_start().starts_with("//"));
    code.flat_map(|line| {
        line.split("crate::")
            .skip(1)
            .map(|rest| rest.split(|c: char| !(c.is_alphanumeric() || c == '_')).next().unwrap().to_owned())
            .collect::<Vec<_>>()
    })
    .filter(|name| !["choices", "knobs", ""].contains(&name.as_str()))
    .collect()
}

#[test]
fn modules_use_lower_layers_only() {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut wrong = Vec::new();
    for path in rust_files(&source) {
        let relative = path.strip_prefix(&source).unwrap();
        let first = relative.components().next().unwrap().as_os_str().to_string_lossy().into_owned();
        let module = first.trim_end_matches(".rs");
        if ["lib", "bin"].contains(&module) {
            continue;
        }
        for import in imports(&fs::read_to_string(&path).unwrap()) {
            if import != module && layer(&import) >= layer(module) {
                wrong.push(format!("{} uses {import}", relative.display()));
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn only_ros_knows_rosrust_and_matching_reads_no_clock() {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    for path in rust_files(&source) {
        let text = fs::read_to_string(&path).unwrap();
        let relative = path.strip_prefix(&source).unwrap();
        if !relative.starts_with("ros") {
            // The serde codec of ROS messages has a similar name.
            assert!(!text.replace("roslibrust_serde_rosmsg", "").contains("rosrust::"), "{}", relative.display());
        }
        if relative.starts_with("matching") {
            for word in ["Instant", "SystemTime", "println!", "eprintln!", "Clock"] {
                assert!(!text.contains(word), "{} has {word}", relative.display());
            }
        }
        if relative.starts_with("bin") {
            continue;
        }
        assert!(!text.contains("clap"), "{} reads arguments", relative.display());
    }
}

#[test]
fn unsafe_code_is_in_two_files() {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let allowing = |path: &PathBuf| fs::read_to_string(path).unwrap().contains("allow(unsafe_code)");
    let mut files: Vec<_> = rust_files(&source).into_iter().filter(allowing).collect();
    files.sort();
    assert_eq!(files, ["ros/node_api.rs", "shared_memory/mapping.rs"].map(|file| source.join(file)));
}
