//! Instructions of one match, counted by callgrind, so that other programs have no influence. They are compared with
//! `benches/instructions.csv` if that was written with the same compiler for the same instruction set. The profile `counted` compiles the
//! library as one codegen unit, so that a change affects only the figures of the code it touches:
//! `cargo test --profile counted --no-default-features --bench instructions`; `UPDATE_GOLDEN=1` updates the file.
#![allow(missing_docs, clippy::panic, clippy::unwrap_used, clippy::print_stdout, clippy::print_stderr)]

mod walk;

use std::fmt::Write;
use std::hint::black_box;
use std::path::Path;
use std::process::{Command, ExitCode, Output};
use std::{env, fs};

use anytime_scan_matcher::matching::classic::correspondence::CorrespondenceKind;
use anytime_scan_matcher::matching::classic::rejection::RejectionKnobs;
use anytime_scan_matcher::matching::{Matcher, MatchingKnobs};
use fearless_simd::Level;
use walk::{LASERS, Laser, Pair, match_pair, walk};

/// Each figure is the mean of this many matches.
const MATCHES: u32 = 20;
/// Maximum relative difference from the stored figure. A larger change should be noticed and accepted by a person.
const TOLERANCE: f64 = 0.03;
/// First argument of the runs whose instructions are counted.
const COUNTED: &str = "--counted";
/// Argument of the run that prints the instruction set for which the matcher chooses its code.
const LEVEL: &str = "--level";
const STAGES: [&str; 3] = ["view", "projective", "jump_table"];

fn main() -> ExitCode {
    let arguments: Vec<String> = env::args().skip(1).collect();
    match arguments.as_slice() {
        [first, stage, beams] if first == COUNTED => {
            run(stage, beams.parse().unwrap());
            ExitCode::SUCCESS
        }
        [only] if only == LEVEL => {
            println!("{:?}", Level::new());
            ExitCode::SUCCESS
        }
        _ => check(),
    }
}

/// The program that runs under callgrind; only the instructions in [`counted`] count.
fn run(stage: &str, beams: usize) {
    let (degrees, _) = LASERS.into_iter().find(|laser| laser.1 == beams).unwrap();
    let correspondence = if stage == "jump_table" { CorrespondenceKind::JumpTable } else { CorrespondenceKind::Projective };
    let mut matcher = Matcher::new(&MatchingKnobs { correspondence, ..MatchingKnobs::default() }, &RejectionKnobs::default());
    let pairs = walk(Laser::with_field_of_view(degrees, beams), MATCHES + 1);
    match_pair(&mut matcher, &pairs[MATCHES as usize], true);
    for pair in &pairs[..MATCHES as usize] {
        counted(stage, &mut matcher, pair);
    }
}

#[inline(never)]
fn counted(stage: &str, matcher: &mut Matcher, pair: &Pair) {
    if stage == "view" {
        matcher.set_reference(black_box(&pair.reference));
    } else {
        black_box(match_pair(matcher, pair, true));
    }
}

/// Runs this program under valgrind.
fn valgrind(tool: &[&str], arguments: &[&str]) -> Output {
    Command::new("valgrind").args(tool).arg(env::current_exe().unwrap()).args(arguments).output().unwrap()
}

/// Whether this program was built with the profile `counted`: cargo has a folder for each profile, with the programs in its `deps`.
fn is_counted_profile() -> bool {
    env::current_exe().unwrap().ancestors().nth(2).is_some_and(|profile| profile.ends_with("counted"))
}

/// What the figures depend on besides the code: instruction set and compiler.
fn environment() -> String {
    let level = String::from_utf8(valgrind(&["--tool=none"], &[LEVEL]).stdout).unwrap();
    let compiler = String::from_utf8(Command::new("rustc").arg("--version").output().unwrap().stdout).unwrap();
    format!("# {}, {}", level.split('(').next().unwrap().trim(), compiler.trim())
}

/// Mean number of instructions of one match.
fn count(stage: &str, beams: usize) -> f64 {
    let tool = ["--tool=callgrind", "--callgrind-out-file=/dev/null", "--toggle-collect=*counted*"];
    let output = valgrind(&tool, &[COUNTED, stage, &beams.to_string()]);
    let log = String::from_utf8_lossy(&output.stderr);
    let total = log.lines().find_map(|line| line.split("Collected :").nth(1)).unwrap_or_else(|| panic!("no count: {log}"));
    total.trim().parse::<f64>().unwrap() / f64::from(MATCHES)
}

fn check() -> ExitCode {
    if !is_counted_profile() {
        eprintln!("SKIPPED: instructions are only counted with --profile counted --no-default-features");
        return ExitCode::SUCCESS;
    }
    if Command::new("valgrind").arg("--version").output().is_err() {
        eprintln!("SKIPPED: instructions are not counted because valgrind is not installed");
        return ExitCode::SUCCESS;
    }
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/instructions.csv");
    let kept = fs::read_to_string(&file).unwrap_or_default();
    let here = environment();
    let mut found = format!("{here}\nstage,beams,instructions\n");
    let mut differ = 0;
    for stage in STAGES {
        for (_, beams) in LASERS {
            let instructions = count(stage, beams);
            let name = format!("{stage},{beams},");
            let expected: Option<f64> = kept.lines().find_map(|line| line.strip_prefix(&name)?.parse().ok());
            let change = expected.map_or(f64::INFINITY, |expected| instructions / expected - 1.0);
            println!("{stage:>10} {beams:>6} beams: {instructions:>10.0} instructions, {:+.1} %", 100.0 * change);
            differ += u32::from(change.abs() > TOLERANCE);
            writeln!(found, "{name}{instructions:.0}").unwrap();
        }
    }
    if env::var_os("UPDATE_GOLDEN").is_some() {
        fs::write(&file, found).unwrap();
        return ExitCode::SUCCESS;
    }
    if let Some(there) = kept.lines().next().filter(|there| *there != here) {
        eprintln!("SKIPPED: these figures ({here}) cannot be compared with those of {} ({there})", file.display());
        return ExitCode::SUCCESS;
    }
    if differ > 0 {
        eprintln!("{differ} figures differ by more than {TOLERANCE} from {}: UPDATE_GOLDEN=1 updates them", file.display());
    }
    ExitCode::from(u8::from(differ > 0))
}
