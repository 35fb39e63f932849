//! Measures the influence of every constant of the matching and the odometry: docs/sensitivity.md.
//!
//! `cargo test --test offline -- --ignored sensitivity` rewrites a copy of the source so that the program reads its constants at run time, times a
//! factor that an environment variable holds, and replays logs with each constant changed by plus and minus thirty percent. Constants that
//! the compiler needs to know, such as lengths of arrays, are changed in the copy, one build for each change.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anytime_scan_matcher::io::bag::{Bag, BagWriter, Compression};
use anytime_scan_matcher::messages::Message as _;
use anytime_scan_matcher::messages::nav_msgs::Odometry;
use anytime_scan_matcher::messages::sensor_msgs::LaserScan;
use anytime_scan_matcher::messages::tf2_msgs::TFMessage;
use rayon::prelude::*;
use serde_json::Value;

use crate::common::shared;
use crate::layers::rust_files;

/// The folders whose constants are changed.
const CORE: [&str; 2] = ["src/matching", "src/odometry"];
/// Relative change of a constant, up and down.
const CHANGE: f64 = 0.3;
/// Constants that change no error by more than this fraction are listed separately.
const LITTLE: f64 = 0.02;
/// Errors whose relative difference is smaller are the same: constants that the compiler does not know may change the rounding.
const ROUNDING: f64 = 1e-9;

/// Added to the copy of the source. `SCALED` holds the name of a constant and its factor, `READ` the file for the names of those that are read.
const FACTOR: &str = r#"
/// The factor of a constant.
pub(crate) fn factor(name: &str) -> f64 {
    if let Ok(file) = std::env::var("READ") {
        let file = std::fs::OpenOptions::new().append(true).open(file);
        std::io::Write::write_all(&mut file.unwrap(), format!("{name}\n").as_bytes()).unwrap();
    }
    let scaled = std::env::var("SCALED").unwrap_or_default();
    scaled.split_once(' ').filter(|scaled| scaled.0 == name).map_or(1.0, |scaled| scaled.1.parse().unwrap())
}
"#;

/// The text of each file of the core, by its path in the source.
type Sources = BTreeMap<PathBuf, String>;

/// A constant of the core.
struct Constant {
    file: PathBuf,
    line: usize,
    /// `pub` or nothing, and what follows it.
    visibility: String,
    name: String,
    kind: String,
    value: String,
    /// The first sentence of its doc comment.
    meaning: String,
}

impl Constant {
    fn is_whole(&self) -> bool {
        !self.kind.starts_with('f')
    }

    /// Its name after that of its module.
    fn path(&self) -> String {
        let named = if self.file.ends_with("mod.rs") { self.file.parent().unwrap() } else { &self.file };
        format!("{}::{}", named.file_stem().unwrap().display(), self.name)
    }

    /// Its value multiplied by `factor`; `None` if that changes nothing.
    fn scaled(&self, factor: f64) -> Option<String> {
        if !self.is_whole() {
            return Some(format!("({}) * {factor}", self.value));
        }
        let value: f64 = self.value.replace('_', "").parse().ok()?;
        let scaled = (value * factor).round();
        (scaled != value && scaled >= 1.0).then(|| format!("{scaled:.0}"))
    }

    /// The file's text with the constant multiplied by `factor`; `None` if that changes nothing.
    fn scaled_in(&self, text: &str, factor: f64) -> Option<String> {
        let value = self.scaled(factor)?;
        let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
        let line = &mut lines[self.line];
        *line = line.replace(&format!("= {};", self.value), &format!("= {value};"));
        Some(lines.join("\n"))
    }

    /// A definition that is evaluated at its first use.
    fn lazy(&self, names: &[&str]) -> String {
        let Self { visibility, name, kind, value, .. } = self;
        let (value, path) = (dereferenced(value, names), self.path());
        let round = if self.is_whole() { ".round()" } else { "" };
        format!(
            "{visibility}static {name}: std::sync::LazyLock<{kind}> = \
             std::sync::LazyLock::new(|| (({value}) as f64 * crate::factor(\"{path}\")){round} as {kind});"
        )
    }
}

/// The files of the core.
fn sources(root: &Path) -> Sources {
    let files = CORE.iter().flat_map(|folder| rust_files(&root.join(folder)));
    files.map(|file| (file.strip_prefix(root).unwrap().to_owned(), fs::read_to_string(&file).unwrap())).collect()
}

/// The numeric constants outside tests, and outside the scalar reference of the fast kernel.
fn constants(sources: &Sources) -> Vec<Constant> {
    let is_used = |file: &Path| !["tests.rs", "specification.rs"].iter().any(|name| file.ends_with(name));
    sources.iter().filter(|(file, _)| is_used(file)).flat_map(|(file, text)| constants_of(file, text)).collect()
}

fn constants_of(file: &Path, text: &str) -> Vec<Constant> {
    let before_tests = text.split("\nmod tests {").next().unwrap_or_default();
    let lines: Vec<&str> = before_tests.lines().collect();
    let constant = |(line, text): (usize, &&str)| {
        let (head, value) = text.trim().strip_suffix(';')?.split_once(" = ")?;
        let (visibility, named) = head.split_once("const ")?;
        let (name, kind) = named.split_once(": ")?;
        let comments = lines[..line].iter().rev().map_while(|line| line.trim().strip_prefix("///")).collect::<Vec<_>>();
        let comment = comments.iter().rev().map(|line| line.trim()).collect::<Vec<_>>().join(" ");
        let is_number = ["f64", "f32", "u32", "usize"].contains(&kind);
        is_number.then(|| Constant {
            file: file.to_owned(),
            line,
            visibility: visibility.to_owned(),
            name: name.to_owned(),
            kind: kind.to_owned(),
            value: value.to_owned(),
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

fn write(sources: &Sources, folder: &Path) {
    for (file, text) in sources {
        fs::write(folder.join(file), text).unwrap();
    }
}

fn is_of_word(letter: char) -> bool {
    letter.is_alphanumeric() || letter == '_'
}

/// A line of code with each use of these names dereferenced.
fn dereferenced(line: &str, names: &[&str]) -> String {
    if line.trim_start().starts_with("use ") {
        return line.to_owned();
    }
    let (code, comment) = line.split_at(line.find("//").unwrap_or(line.len()));
    let use_of = |part: &str| {
        let word = part.trim_end_matches(|letter| !is_of_word(letter));
        if names.contains(&word) { format!("(*{word}){}", &part[word.len()..]) } else { part.to_owned() }
    };
    code.split_inclusive(|letter| !is_of_word(letter)).map(use_of).collect::<String>() + comment
}

/// The sources with these constants read at run time.
fn converted(sources: &Sources, constants: &[Constant]) -> Sources {
    let convert = |(file, text): (&PathBuf, &String)| {
        let is_visible = |constant: &&Constant| constant.file == *file || !constant.visibility.is_empty();
        let names: Vec<&str> = constants.iter().filter(is_visible).map(|constant| constant.name.as_str()).collect();
        let convert = |(number, line): (usize, &str)| {
            let constant = constants.iter().find(|constant| constant.file == *file && constant.line == number);
            constant.map_or_else(|| dereferenced(line, &names), |constant| constant.lazy(&names))
        };
        let lines: Vec<String> = text.lines().enumerate().map(convert).collect();
        (file.clone(), lines.join("\n"))
    };
    sources.iter().map(convert).collect()
}

/// A program, and a variable of its environment.
struct Program {
    file: PathBuf,
    variable: Option<(&'static str, String)>,
}

/// Builds the program in this folder; if that fails, the source lines that the errors point to.
fn build(folder: &Path) -> Result<Program, String> {
    let target = folder.with_file_name("target");
    let build =
        ["build", "--release", "--no-default-features", "--features", "cli", "--bin", "anytime", "--message-format", "json"];
    let output = Command::new(env!("CARGO"))
        .current_dir(folder)
        .env("CARGO_INCREMENTAL", "1")
        .args(build)
        .arg("--target-dir")
        .arg(&target)
        .output()
        .unwrap();
    if output.status.success() {
        return Ok(Program { file: target.join("release/anytime"), variable: None });
    }
    let messages = output.stdout.split(|&byte| byte == b'\n').filter_map(|line| serde_json::from_slice::<Value>(line).ok());
    let errors = messages.filter(|message| message["message"]["level"] == "error");
    let array = |value: &Value| value.as_array().cloned().unwrap_or_default();
    let spans = errors.flat_map(|error| array(&error["message"]["spans"])).filter(|span| span["is_primary"] == true);
    let lines = spans.flat_map(|span| array(&span["text"])).filter_map(|line| Some(line["text"].as_str()?.to_owned() + "\n"));
    Err(lines.collect())
}

/// Builds a program that reads its constants at run time; also those that it reads, and those that the compiler needs to know.
fn program_that_reads(mut constants: Vec<Constant>, sources: &Sources, folder: &Path) -> (Program, Vec<Constant>, Vec<Constant>) {
    let mut fixed = Vec::new();
    loop {
        write(&converted(sources, &constants), folder);
        let lines = match build(folder) {
            Ok(program) => return (program, constants, fixed),
            Err(lines) => lines,
        };
        let words: Vec<&str> = lines.split(|letter| !is_of_word(letter)).collect();
        let (named, others): (Vec<_>, Vec<_>) =
            constants.into_iter().partition(|constant| words.contains(&constant.name.as_str()));
        assert!(!named.is_empty(), "errors without a constant: {lines}");
        eprintln!("builds of their own: {}", named.iter().map(Constant::path).collect::<Vec<_>>().join(", "));
        fixed.extend(named);
        constants = others;
    }
}

fn json(program: &Program, arguments: &[&str]) -> Option<Value> {
    let output = Command::new(&program.file).args(arguments).arg("--json").envs(program.variable.clone()).output().ok()?;
    serde_json::from_slice(&output.stdout).ok()
}

/// Computes an error of a program, m.
type Measure = Box<dyn Fn(&Program) -> Option<f64> + Send + Sync>;

/// A copy in this folder of a log beside the checkout, without the compression that most of a replay's time is spent on.
fn unpacked(log: &str, folder: &Path) -> Option<PathBuf> {
    let bag = Bag::open(shared(log)?).unwrap();
    let path = folder.join(Path::new(log).file_name()?);
    let mut writer = BagWriter::create_whole(&path, Compression::None).unwrap();
    for message in bag.messages(None) {
        let message = message.unwrap();
        let (topic, time) = (message.connection.topic.as_str(), message.time);
        match message.connection.message_type.as_str() {
            LaserScan::TYPE => writer.write(topic, time, &message.decode::<LaserScan>().unwrap()),
            Odometry::TYPE => writer.write(topic, time, &message.decode::<Odometry>().unwrap()),
            TFMessage::TYPE => writer.write_latched(topic, time, &message.decode::<TFMessage>().unwrap()),
            _ => Ok(()),
        }
        .unwrap();
    }
    writer.finish().unwrap();
    Some(path)
}

/// Mean error of the relations of a log.
fn relations(folder: &Path, log: &str, laser_in_base: &'static str) -> Measure {
    let (bag, relations) = (unpacked(&format!("data/{log}/{log}.bag"), folder), shared(&format!("data/{log}/{log}.relations")));
    Box::new(move |program| {
        let path = tempfile::NamedTempFile::new().ok()?;
        let tum = path.path().to_str()?;
        let mount = format!("odometry.laser_in_base={laser_in_base}");
        json(program, &["replay", bag.as_ref()?.to_str()?, "--tum", tum, "--set", &mount])?;
        let found = json(program, &["evaluate", tum, "--relations", relations.as_ref()?.to_str()?])?;
        found["relations"]["trans_m"]["mean"].as_f64()
    })
}

/// RMSE of the positions.
fn positions(bag: Option<PathBuf>, truth: Option<PathBuf>, more: &'static [&'static str]) -> Measure {
    Box::new(move |program| {
        let arguments = ["replay", bag.as_ref()?.to_str()?, "--truth", truth.as_ref()?.to_str()?];
        json(program, &[&arguments[..], more].concat())?["ate_rmse_m"].as_f64()
    })
}

/// RMSE of the positions in a simulated drive among people, written to this folder.
fn among_people(program: &Program, folder: &Path, map: &str) -> Measure {
    let [bag, truth] = ["bag", "tum"].map(|ending| folder.join(format!("{map}.{ending}")));
    let world = shared(&format!("data/maps/{map}.yaml")).unwrap();
    let [world, out, poses] = [&world, &bag, &truth].map(|path| path.to_str().unwrap());
    let drive = ["--duration", "60", "--speed", "5", "--seed", "5", "--walkers", "20", "--beams", "541"];
    json(program, &[&["simulate", "--world", world, "--out", out, "--truth", poses], &drive[..]].concat()).unwrap();
    positions(Some(bag), Some(truth), &[])
}

/// The measured errors, by name.
fn measures(root: &Path, program: &Program, folder: &Path) -> Vec<(&'static str, Measure)> {
    let levine = unpacked("data/racecar-levine/racecar-levine.bag", folder);
    let levine = |more| positions(levine.clone(), shared("data/racecar-levine/truth.tum"), more);
    let case = |bag, truth| positions(shared(&format!("cases/{bag}.bag")), shared(&format!("cases/truth/{truth}.tum")), &[]);
    vec![
        ("fr079", relations(folder, "fr079", "[-0.04,0,0]")),
        ("aces", relations(folder, "aces", "[0,0,0]")),
        ("intel", relations(folder, "intel", "[0,0,0]")),
        ("racecar-levine", levine(&[])),
        ("the same, scans alone", levine(&["--scan-only"])),
        ("demo, scans alone", positions(Some(root.join("bags/demo.bag")), Some(root.join("bags/demo.tum")), &["--scan-only"])),
        ("berlin, 20 people", among_people(program, folder, "berlin")),
        ("wrong IMU", case("k6_imu_ned", "turny")),
        ("long sweeps", case("k11_negative_time_increment", "skew")),
        ("blind at first", case("k10_blind_start", "b270")),
    ]
}

/// An error of each log; `None` if the program fails.
type Errors = Vec<Option<f64>>;

fn errors(program: &Program, measures: &[(&str, Measure)]) -> Errors {
    measures.iter().map(|(_, measure)| measure(program)).collect()
}

/// The names of the constants that the program reads for this error.
fn read_for(measure: &Measure, program: &Program) -> Vec<String> {
    let file = tempfile::NamedTempFile::new().unwrap();
    let variable = Some(("READ", file.path().to_str().unwrap().to_owned()));
    measure(&Program { file: program.file.clone(), variable });
    fs::read_to_string(&file).unwrap().lines().map(str::to_owned).collect()
}

/// A constant, and the errors if it is smaller and if it is greater; `None` if it cannot be changed.
struct Row {
    constant: Constant,
    changed: [Option<Errors>; 2],
    /// How many logs use it, if known.
    users: Option<usize>,
}

/// The relative change of an error.
fn change(error: Option<f64>, baseline: Option<f64>) -> f64 {
    error.zip(baseline).map_or(f64::INFINITY, |(error, baseline)| (error / baseline - 1.0).abs())
}

impl Row {
    /// The relative changes of the error of a log.
    fn changes(&self, baseline: &Errors, log: usize) -> impl Iterator<Item = f64> {
        self.changed.iter().flatten().map(move |errors| change(errors[log], baseline[log]))
    }

    /// The largest relative change of an error.
    fn influence(&self, baseline: &Errors) -> f64 {
        (0..baseline.len()).flat_map(|log| self.changes(baseline, log)).fold(0.0, f64::max)
    }

    /// The errors of a log, unless they are as without the change.
    fn cell(&self, baseline: &Errors, log: usize) -> String {
        let [smaller, greater] =
            self.changed.each_ref().map(|errors| errors.as_ref().map_or("-".into(), |errors| millimetres(errors[log])));
        let same = millimetres(baseline[log]);
        if [&smaller, &greater].iter().all(|cell| **cell == same || *cell == "-") {
            String::new()
        } else {
            format!("{smaller}, {greater}")
        }
    }
}

fn millimetres(error: Option<f64>) -> String {
    error.map_or("lost".into(), |error| format!("{:.1}", 1e3 * error))
}

/// Measures each constant with a program that reads it at run time, one on each processor. What a log does not use cannot change its error.
fn measure_read(program: &Program, constants: Vec<Constant>, measures: &[(&str, Measure)], baseline: &Errors) -> Vec<Row> {
    let used: Vec<Vec<String>> = measures.iter().map(|(_, measure)| read_for(measure, program)).collect();
    let measure = |constant: Constant| {
        let path = constant.path();
        let is_used: Vec<bool> = used.iter().map(|used| used.contains(&path)).collect();
        let changed = [1.0 - CHANGE, 1.0 + CHANGE].map(|factor| {
            constant.scaled(factor)?;
            let program = Program { file: program.file.clone(), variable: Some(("SCALED", format!("{path} {factor}"))) };
            let error = |log: usize| if is_used[log] { measures[log].1(&program) } else { baseline[log] };
            Some((0..measures.len()).map(error).collect())
        });
        eprintln!("{path} {changed:?}");
        Row { constant, changed, users: Some(is_used.iter().filter(|used| **used).count()) }
    };
    constants.into_par_iter().map(measure).collect()
}

/// Measures a constant with one build for each change.
fn measure_built(folder: &Path, sources: &Sources, constant: Constant, measures: &[(&str, Measure)]) -> Row {
    let (file, text) = (folder.join(&constant.file), &sources[&constant.file]);
    let changed = [1.0 - CHANGE, 1.0 + CHANGE].map(|factor| {
        fs::write(&file, constant.scaled_in(text, factor)?).unwrap();
        build(folder).ok().map(|program| errors(&program, measures))
    });
    fs::write(&file, text).unwrap();
    eprintln!("{} {changed:?}", constant.path());
    Row { constant, changed, users: None }
}

#[test]
#[ignore = "an hour: replays all logs twice for each constant"]
fn sensitivity_of_the_constants() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("sensitivity");
    let copied = folder.join("source");
    let _ = fs::remove_dir_all(&copied);
    copy(root, &copied);
    let sources = sources(&copied);
    let library = copied.join("src/lib.rs");
    fs::write(&library, fs::read_to_string(&library).unwrap() + FACTOR).unwrap();

    let (program, read, fixed) = program_that_reads(constants(&sources), &sources, &copied);
    eprintln!("{} constants are read at run time, {} need builds of their own", read.len(), fixed.len());
    let measures = measures(root, &program, &folder);
    let baseline = errors(&program, &measures);
    assert!(baseline.iter().all(Option::is_some), "the logs beside the checkout are needed: {baseline:?}");
    let names: Vec<&str> = measures.iter().map(|(name, _)| *name).collect();
    let mut rows = measure_read(&program, read, &measures, &baseline);
    let save = |rows: &mut Vec<Row>| {
        rows.sort_by(|a, b| b.influence(&baseline).total_cmp(&a.influence(&baseline)));
        fs::write(root.join("docs/sensitivity.md"), document(&names, &baseline, rows)).unwrap();
    };
    save(&mut rows);

    write(&sources, &copied);
    let unmodified = errors(&build(&copied).unwrap(), &measures);
    let is_same = unmodified.iter().zip(&baseline).all(|(&error, &baseline)| change(error, baseline) < ROUNDING);
    assert!(is_same, "the unmodified program has other errors: {unmodified:?} {baseline:?}");
    for constant in fixed {
        rows.push(measure_built(&copied, &sources, constant, &measures));
        save(&mut rows);
    }
}

/// The median change of the error of a log, of all changes that have an effect on it.
fn median_change(rows: &[Row], baseline: &Errors, log: usize) -> f64 {
    let mut changes: Vec<f64> =
        rows.iter().flat_map(|row| row.changes(baseline, log)).filter(|change| *change > ROUNDING).collect();
    changes.sort_by(f64::total_cmp);
    changes.get(changes.len() / 2).copied().unwrap_or_default()
}

/// What the document says about the table.
const INTRODUCTION: &str = "# What the constants are worth

Errors in mm with each constant of the matching and the odometry 30 % smaller and 30 % greater: mean of the relations (fr079, aces, intel), or RMSE of the
positions. An empty cell: neither error is another. `-`: it cannot be changed by so much. `lost`: the program fails. Generated: `cargo test --test offline --
--ignored sensitivity`.

Most: the largest change of an error. Median change: that of all changes that have an effect on the log at all, a measure of chance, as when a place is recognised
one keyframe earlier or later. Most changes move fr079, aces and intel by no more than a few percent; what exceeds that
on one log alone is mostly a place missed.

";

/// What it says about constants with little influence.
const LITTLE_INFLUENCE: &str = "They bound what a log seldom shows: rare cases, costs, memory.

| constant | value | logs that use it | meaning |
|---|---|---|---|
";

fn document(names: &[&str], baseline: &Errors, rows: &[Row]) -> String {
    let logs = 0..names.len();
    let medians: Vec<String> = logs.clone().map(|log| format!("{:.1} %", 100.0 * median_change(rows, baseline, log))).collect();
    let same: Vec<String> = baseline.iter().map(|&error| millimetres(error)).collect();
    let mut text = INTRODUCTION.to_owned();
    let _ = writeln!(text, "| constant | value | most | {} |\n|{}", names.join(" | "), "---|".repeat(names.len() + 3));
    let _ = writeln!(text, "| as they are | | | {} |\n| median change | | | {} |", same.join(" | "), medians.join(" | "));
    let (measured, others): (Vec<&Row>, Vec<&Row>) = rows.iter().partition(|row| row.changed.iter().any(Option::is_some));
    let (little, much): (Vec<&Row>, Vec<&Row>) = measured.into_iter().partition(|row| row.influence(baseline) < LITTLE);
    for row in much {
        let cells: Vec<String> = logs.clone().map(|log| row.cell(baseline, log)).collect();
        let (path, value, influence) = (row.constant.path(), &row.constant.value, 100.0 * row.influence(baseline));
        let _ = writeln!(text, "| `{path}` | {value} | {influence:.0} % | {} |", cells.join(" | "));
    }
    let _ = write!(text, "\n## Those that change no error by {:.0} %\n\n{LITTLE_INFLUENCE}", 100.0 * LITTLE);
    for Row { constant, users, .. } in little {
        let users = users.map(|users| users.to_string()).unwrap_or_default();
        let _ = writeln!(text, "| `{}` | {} | {users} | {} |", constant.path(), constant.value, constant.meaning);
    }
    let others: Vec<String> = others.iter().map(|row| format!("`{}`", row.constant.path())).collect();
    let _ = writeln!(text, "\nNot measured, as they cannot be changed alone: {}.", others.join(", "));
    text
}
