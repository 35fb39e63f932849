//! Checks the architecture of `src/lib.rs` against the imports: a module uses only modules of the layers below its own, and the modules of a
//! folder do not use each other in a cycle.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// From the bottom up. Modules of one layer do not use each other.
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

/// The source files in a folder and its subfolders.
pub(crate) fn rust_files(folder: &Path) -> Vec<PathBuf> {
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

/// Names after `crate::` in code, without comments.
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

/// A module's path below `src`: `["ros", "mailbox"]`.
fn module(source: &Path, file: &Path) -> Vec<String> {
    let relative = file.strip_prefix(source).unwrap().with_extension("");
    let mut names: Vec<String> = relative.iter().map(|name| name.to_string_lossy().into_owned()).collect();
    names.pop_if(|name| name == "mod");
    names
}

/// The paths that a file of `module` imports with `use`, from the crate's root; without tests.
fn used(text: &str, module: &[String]) -> Vec<Vec<String>> {
    let code = text.split("#[cfg(test)]").next().unwrap();
    let statements = code.split("use ").skip(1).filter_map(|rest| rest.split(';').next());
    let mut paths = Vec::new();
    statements.for_each(|statement| expand(String::new(), statement, &mut paths));
    let from_root = |path: String| {
        let mut names: Vec<String> = path.split("::").map(|name| name.trim().to_owned()).collect();
        let above = names.iter().take_while(|name| *name == "super").count();
        match names[0].as_str() {
            "crate" => Some(names.split_off(1)),
            "super" => Some([&module[..module.len() - above], &names[above..]].concat()),
            _ => None,
        }
    };
    paths.into_iter().filter_map(from_root).collect()
}

/// Every path of a tree of imports, such as `a::{b, c::d}`.
fn expand(prefix: String, tree: &str, paths: &mut Vec<String>) {
    let Some((stem, rest)) = tree.split_once('{') else { return paths.push(prefix + tree.trim()) };
    let (mut depth, mut start) = (0, 0);
    let inner = rest.rsplit_once('}').map_or(rest, |(inner, _)| inner);
    for (place, c) in inner.char_indices().chain([(inner.len(), ',')]) {
        match c {
            '{' => depth += 1,
            '}' => depth -= 1,
            ',' if depth == 0 => {
                let branch = inner[start..place].trim();
                if !branch.is_empty() {
                    expand(prefix.clone() + stem.trim(), branch, paths);
                }
                start = place + 1;
            }
            _ => {}
        }
    }
}

/// The imports within each folder: `folder, module` to the modules of the same folder that it uses.
fn uses_in_folders(source: &Path) -> BTreeMap<(Vec<String>, String), BTreeSet<String>> {
    let files: Vec<PathBuf> = rust_files(source).into_iter().filter(|path| !path.starts_with(source.join("bin"))).collect();
    let modules: BTreeSet<Vec<String>> = files.iter().map(|path| module(source, path)).collect();
    let mut uses: BTreeMap<(Vec<String>, String), BTreeSet<String>> = BTreeMap::new();
    for path in &files {
        let user = module(source, path);
        for used in used(&fs::read_to_string(path).unwrap(), &user) {
            let common = used.iter().zip(&user).take_while(|(a, b)| a == b).count();
            let sibling = &used[..(common + 1).min(used.len())];
            if common > 0 && user.len() > common && modules.contains(sibling) && sibling.len() > common {
                uses.entry((user[..common].to_vec(), user[common].clone())).or_default().insert(sibling[common].clone());
            }
        }
    }
    uses
}

#[test]
fn modules_of_a_folder_do_not_use_each_other_in_a_cycle() {
    let uses = uses_in_folders(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src"));
    assert!(uses.len() > 100, "{}", uses.len());
    for (folder, start) in uses.keys() {
        let (mut reached, mut open) = (BTreeSet::new(), vec![start.clone()]);
        while let Some(next) = open.pop() {
            let others = uses.get(&(folder.clone(), next)).into_iter().flatten();
            open.extend(others.filter(|other| reached.insert((*other).clone())).cloned());
        }
        assert!(!reached.contains(start), "{}/{start} uses itself through some of {reached:?}", folder.join("/"));
    }
}

#[test]
fn import_trees_are_parsed() {
    let module = ["ros".to_owned(), "matcher".to_owned()];
    let paths =
        used("use super::{log::Log, a::{self, b}};\nuse std::fs;\nuse crate::app::App;\n#[cfg(test)] use super::no;", &module);
    let paths: Vec<String> = paths.iter().map(|path| path.join("/")).collect();
    assert_eq!(paths, ["ros/log/Log", "ros/a/self", "ros/a/b", "app/App"]);
}

#[test]
fn only_ros_uses_rosrust_and_matching_reads_no_clock() {
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
