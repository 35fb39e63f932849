//! Measures the influence of every constant of the matching and the odometry: docs/sensitivity.md.
//!
//! `cargo test --test offline -- --ignored sensitivity` changes one constant at a time in a copy of the source, by plus and minus thirty percent,
//! builds the program and replays the logs beside the checkout with it.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

use crate::common::shared;
use crate::layers::rust_files;

/// The folders whose constants are changed.
const CORE: [&str; 2] = ["src/matching", "src/odometry"];
/// Relative change of a constant, up and down.
const CHANGE: f64 = 0.3;
/// Constants that change no error by more than this fraction are listed separately.
const LITTLE: f64 = 0.02;

/// A constant of the core.
struct Constant {
    file: PathBuf,
    line: usize,
    name: String,
    value: String,
    is_whole: bool,
    /// The first sentence of its doc comment.
    meaning: String,
}

impl Constant {
    /// The file's text with the constant multiplied by `factor`; `None` if that changes nothing.
    fn scaled(&self, text: &str, factor: f64) -> Option<String> {
        let value = if self.is_whole {
            let value: f64 = self.value.replace('_', "").parse().ok()?;
            let scaled = (value * factor).round();
            (scaled != value && scaled >= 1.0).then(|| format!("{scaled:.0}"))?
        } else {
            format!("({}) * {factor}", self.value)
        };
        let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
        let line = &mut lines[self.line];
        *line = line.replace(&format!("= {};", self.value), &format!("= {value};"));
        Some(lines.join("\n"))
    }
}

/// The numeric constants outside tests, and outside the scalar reference of the fast kernel.
fn constants(root: &Path) -> Vec<Constant> {
    let mut files: Vec<PathBuf> = CORE.iter().flat_map(|folder| rust_files(&root.join(folder))).collect();
    files.retain(|file| !["tests.rs", "specification.rs"].iter().any(|name| file.ends_with(name)));
    files.sort();
    files.iter().flat_map(|file| constants_of(file)).collect()
}

fn constants_of(file: &Path) -> Vec<Constant> {
    let text = fs::read_to_string(file).unwrap();
    let lines: Vec<&str> = text.lines().take_while(|line| !line.starts_with("#[cfg(test)]")).collect();
    let constant = |(line, text): (usize, &&str)| {
        let (head, value) = text.trim().strip_suffix(';')?.split_once(" = ")?;
        let (name, kind) = head.split_once("const ")?.1.split_once(": ")?;
        let comments = lines[..line].iter().rev().map_while(|line| line.trim().strip_prefix("///")).collect::<Vec<_>>();
        let comment = comments.iter().rev().map(|line| line.trim()).collect::<Vec<_>>().join(" ");
        let is_number = ["f64", "f32", "u32", "usize"].contains(&kind);
        is_number.then(|| Constant {
            file: file.to_owned(),
            line,
            name: name.to_owned(),
            value: value.to_owned(),
            is_whole: !kind.starts_with('f'),
            meaning: comment.split_inclusive(". ").next().unwrap_or_default().trim().replace('|', "/"),
        })
    };
    lines.iter().enumerate().filter_map(constant).collect()
}

/// Copies the source of the program.
fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap();
        if path.is_dir() && name != "target" && name != ".git" {
            copy(&path, &to.join(name));
        } else if path.is_file() {
            fs::copy(&path, to.join(name)).unwrap();
        }
    }
}

/// The program built in this folder; `None` if it does not build.
fn build(folder: &Path) -> Option<PathBuf> {
    let target = folder.join("target");
    let build = ["build", "--quiet", "--no-default-features", "--features", "cli", "--bin", "anytime", "--target-dir"];
    let output = Command::new(env!("CARGO")).current_dir(folder).args(build).arg(&target).output().unwrap();
    output.status.success().then(|| target.join("debug/anytime"))
}

fn json(program: &Path, arguments: &[&str]) -> Option<Value> {
    let output = Command::new(program).args(arguments).arg("--json").output().ok()?;
    serde_json::from_slice(&output.stdout).ok()
}

/// Mean error of the relations of a log, m.
fn relations(program: &Path, log: &str, mount: &str) -> Option<f64> {
    let (bag, relations) = (shared(&format!("data/{log}/{log}.bag"))?, shared(&format!("data/{log}/{log}.relations"))?);
    let path = tempfile::NamedTempFile::new().ok()?;
    let tum = path.path().to_str()?;
    json(program, &["replay", bag.to_str()?, "--tum", tum, "--set", &format!("odometry.laser_in_base={mount}")])?;
    json(program, &["evaluate", tum, "--relations", relations.to_str()?])?["relations"]["trans_m"]["mean"].as_f64()
}

/// Absolute error of a trajectory, m.
fn absolute(program: &Path, bag: &Path, truth: &Path, more: &[&str]) -> Option<f64> {
    let arguments = ["replay", bag.to_str()?, "--truth", truth.to_str()?];
    json(program, &[&arguments[..], more].concat())?["ate_rmse_m"].as_f64()
}

type Measure = Box<dyn Fn(&Path) -> Option<f64> + Sync>;

/// The measured errors, by name, m.
fn measures(root: &Path) -> Vec<(&'static str, Measure)> {
    let levine = |more: &'static [&'static str]| -> Measure {
        let files = shared("data/racecar-levine/racecar-levine.bag").zip(shared("data/racecar-levine/truth.tum"));
        Box::new(move |program| files.as_ref().and_then(|(bag, truth)| absolute(program, bag, truth, more)))
    };
    let (demo, truth) = (root.join("bags/demo.bag"), root.join("bags/demo.tum"));
    vec![
        ("fr079", Box::new(|program| relations(program, "fr079", "[-0.04,0,0]"))),
        ("aces", Box::new(|program| relations(program, "aces", "[0,0,0]"))),
        ("intel", Box::new(|program| relations(program, "intel", "[0,0,0]"))),
        ("racecar-levine", levine(&[])),
        ("the same, scans alone", levine(&["--scan-only"])),
        ("demo, scans alone", Box::new(move |program| absolute(program, &demo, &truth, &["--scan-only"]))),
    ]
}

fn errors(program: &Path, measures: &[(&str, Measure)]) -> Vec<Option<f64>> {
    std::thread::scope(|scope| {
        let running: Vec<_> = measures.iter().map(|(_, measure)| scope.spawn(move || measure(program))).collect();
        running.into_iter().map(|running| running.join().unwrap()).collect()
    })
}

/// The errors with a smaller and a larger constant; `None` if it cannot be changed.
type Changed = [Option<Vec<Option<f64>>>; 2];

fn cells(changed: &Changed, log: usize) -> String {
    let cell = |errors: &Option<Vec<Option<f64>>>| match errors {
        None => "-".to_owned(),
        Some(errors) => errors[log].map_or_else(|| "lost".into(), |error| format!("{error:.4}")),
    };
    format!("{}, {}", cell(&changed[0]), cell(&changed[1]))
}

/// The largest relative change of an error.
fn influence(changed: &Changed, baseline: &[Option<f64>]) -> f64 {
    let of = |errors: &Vec<Option<f64>>| {
        let change = |(error, baseline): (&Option<f64>, &Option<f64>)| match (error, baseline) {
            (Some(error), Some(baseline)) => (error / baseline - 1.0).abs(),
            (None, Some(_)) => f64::INFINITY,
            _ => 0.0,
        };
        errors.iter().zip(baseline).map(change).fold(0.0, f64::max)
    };
    changed.iter().flatten().map(of).fold(0.0, f64::max)
}

#[test]
#[ignore = "hours: builds the program twice for each constant"]
fn sensitivity_of_the_constants() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let measures = measures(root);
    let folder = tempfile::tempdir().unwrap();
    let copied = folder.path().join("source");
    copy(root, &copied);
    let baseline = errors(&build(&copied).unwrap(), &measures);
    assert!(baseline.iter().all(Option::is_some), "the logs beside the checkout are needed: {baseline:?}");
    let mut rows = BTreeMap::new();
    for constant in constants(&copied) {
        let text = fs::read_to_string(&constant.file).unwrap();
        let changed = [1.0 - CHANGE, 1.0 + CHANGE].map(|factor| {
            fs::write(&constant.file, constant.scaled(&text, factor)?).unwrap();
            build(&copied).map(|program| errors(&program, &measures))
        });
        fs::write(&constant.file, &text).unwrap();
        let influence = influence(&changed, &baseline);
        let file = constant.file.strip_prefix(&copied).unwrap().display().to_string();
        eprintln!("{file} {}: {:.1} %", constant.name, 100.0 * influence);
        rows.insert((file, constant.line), (constant, changed, influence));
        // Write after each constant, so that an interrupted run keeps its results.
        fs::write(root.join("docs/sensitivity.md"), document(&measures, &baseline, rows.values())).unwrap();
    }
}

fn document<'a>(
    measures: &[(&str, Measure)],
    baseline: &[Option<f64>],
    rows: impl Iterator<Item = &'a (Constant, Changed, f64)>,
) -> String {
    let names: Vec<&str> = measures.iter().map(|(name, _)| *name).collect();
    let mut text = format!(
        "# What the constants are worth\n\nErrors in metres with each constant of the matching and the odometry 30 % smaller and 30 % greater: mean \
         of the relations (fr079, aces, intel), or RMSE of the\npositions. `-`: it cannot be changed by so much. Generated: `cargo test --test \
         offline -- --ignored sensitivity`.\n\n| constant | value | most | {} |\n|{}\n| as it is | | | {} |\n",
        names.join(" | "),
        "---|".repeat(names.len() + 3),
        baseline.iter().map(|error| format!("{:.4}", error.unwrap_or(f64::NAN))).collect::<Vec<_>>().join(" | ")
    );
    let (mut little, mut others) = (Vec::new(), Vec::new());
    for row in rows {
        if row.2 < LITTLE { little.push(row) } else { others.push(row) }
    }
    others.sort_by(|a, b| b.2.total_cmp(&a.2));
    for (constant, changed, influence) in others {
        let errors: Vec<String> = (0..names.len()).map(|log| cells(changed, log)).collect();
        let Constant { name, value, file, .. } = constant;
        let stem = file.file_stem().unwrap_or_default().display();
        let _ = writeln!(text, "| `{stem}::{name}` | {value} | {:.0} % | {} |", 100.0 * influence, errors.join(" | "));
    }
    let _ = write!(
        text,
        "\n## Those that change no error by {:.0} %\n\nThey bound what a log seldom shows: rare cases, costs, memory.\n\n| constant | value | meaning |\n|---|---|---|\n",
        100.0 * LITTLE
    );
    for (Constant { name, value, file, meaning, .. }, ..) in little {
        let stem = file.file_stem().unwrap_or_default().display();
        let _ = writeln!(text, "| `{stem}::{name}` | {value} | {meaning} |");
    }
    text
}
