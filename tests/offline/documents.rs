//! Checks the documents against the code: the table of parameters, links, paths, the two commands of the README.
//! `UPDATE_GOLDEN=1 cargo test --test offline documents` updates the table.

use std::fs;
use std::path::{Path, PathBuf};

use anytime_scan_matcher::config::Config;

const BEGIN: &str = "<!-- parameters: begin (generated, see tests/offline/documents.rs) -->\n";
const END: &str = "<!-- parameters: end -->";

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// All documents with their path from the root.
fn documents() -> Vec<(PathBuf, String)> {
    let mut found = Vec::new();
    for folder in ["", "docs"] {
        for entry in fs::read_dir(root().join(folder)).unwrap() {
            let path = entry.unwrap().path();
            if path.extension().is_some_and(|extension| extension == "md") {
                let text = fs::read_to_string(&path).unwrap();
                found.push((path.strip_prefix(root()).unwrap().to_owned(), text));
            }
        }
    }
    assert!(found.len() > 10, "{found:?}");
    found
}

/// The headings of a document as GitHub anchors.
fn anchors(text: &str) -> Vec<String> {
    let headings = text.lines().filter(|line| line.starts_with('#'));
    headings
        .map(|line| {
            let title = line.trim_start_matches('#').trim().to_lowercase().replace(' ', "-");
            title.chars().filter(|c| c.is_alphanumeric() || ['-', '_'].contains(c)).collect()
        })
        .collect()
}

/// Whether the target of a link exists. Links to other sites are not checked.
fn target_exists(document: &Path, text: &str, link: &str) -> bool {
    if link.starts_with("http") {
        return true;
    }
    let (file, anchor) = link.split_once('#').unwrap_or((link, ""));
    let target = root().join(document).parent().unwrap().join(file);
    let text = match file {
        "" => text.to_owned(),
        _ if !target.exists() => return false,
        _ => fs::read_to_string(&target).unwrap_or_default(),
    };
    anchor.is_empty() || anchors(&text).iter().any(|known| known == anchor)
}

/// Words in code, inline or in blocks, that name a file or folder of this project.
fn paths(text: &str) -> impl Iterator<Item = &str> {
    const FOLDERS: [&str; 14] = [
        "src/",
        "tests/",
        "docs/",
        "examples/",
        "benches/",
        "launch/",
        "definitions/",
        "msg/",
        "maps/",
        "bags/",
        "include/",
        ".ci/",
        ".github/",
        ".cargo/",
    ];
    let code = text.split('`').skip(1).step_by(2);
    code.flat_map(str::split_whitespace)
        .filter(|word| FOLDERS.iter().any(|folder| word.starts_with(folder)))
        .filter(|word| !word.contains(['*', '<', '$', '{']))
        .map(|word| word.trim_end_matches([',', ';', ':', ')']))
}

#[test]
fn the_table_of_parameters_is_up_to_date() {
    let path = root().join("docs/parameters.md");
    let document = fs::read_to_string(&path).unwrap();
    let (before, rest) = document.split_once(BEGIN).unwrap();
    let (found, after) = rest.split_once(END).unwrap();
    let expected = Config::default().markdown_table();
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        fs::write(&path, [before, BEGIN, &expected, END, after].concat()).unwrap();
    } else {
        let differs = found.lines().zip(expected.lines()).find(|(found, expected)| found != expected);
        assert!(found == expected, "update the table (UPDATE_GOLDEN=1 cargo test --test offline documents): {differs:#?}");
    }
}

#[test]
fn links_and_paths_exist() {
    let mut broken = Vec::new();
    for (document, text) in documents() {
        let links = text.split("](").skip(1).filter_map(|rest| rest.split(')').next());
        let links = links.filter(|link| !target_exists(&document, &text, link));
        let missing = links.chain(paths(&text).filter(|path| !root().join(path).exists()));
        broken.extend(missing.map(|target| format!("{}: {target}", document.display())));
    }
    assert!(broken.is_empty(), "broken links and paths:\n{}", broken.join("\n"));
}

/// The README begins with the commands to try the project and to test it, and CI runs the same commands.
#[test]
fn the_readme_starts_with_the_two_commands_that_ci_runs() {
    let readme = fs::read_to_string(root().join("README.md")).unwrap();
    let checks = fs::read_to_string(root().join(".ci/run")).unwrap();
    let first_screen: Vec<&str> = readme.lines().take(25).collect();
    let commands = first_screen.iter().filter(|line| line.starts_with("cargo "));
    let commands: Vec<&str> = commands.map(|line| line.split('#').next().unwrap().trim()).collect();
    let [run, test] = commands[..] else { panic!("expected two commands: {commands:?}") };
    assert!(run.starts_with("cargo run") && test == "cargo test", "{commands:?}");
    for command in commands {
        let step = format!("step {command}");
        assert!(checks.lines().any(|line| line == step), "'{step}' is missing in .ci/run");
    }
}

#[test]
fn the_ten_places_of_the_contributing_guide_exist() {
    let text = fs::read_to_string(root().join("CONTRIBUTING.md")).unwrap();
    let (_, section) = text.split_once("## Ten places").unwrap();
    let (section, _) = section.split_once("\n## ").unwrap();
    let places: Vec<Vec<&str>> =
        section.lines().map(|line| line.split('`').skip(1).step_by(2).collect()).filter(|row: &Vec<_>| row.len() == 2).collect();
    assert_eq!(places.len(), 10);
    for place in places {
        let [file, name] = place[..] else { unreachable!() };
        let code = fs::read_to_string(root().join(file)).unwrap();
        assert!(code.contains(name), "{file} has no '{name}'");
    }
}
