//! The output of `anytime`: it fits the terminal, programs can read it, and it names the files written.

use std::collections::BTreeSet;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

fn anytime(words: &[&str], columns: Option<&str>) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_anytime"));
    command.args(words).current_dir(env!("CARGO_MANIFEST_DIR")).env_remove("COLUMNS");
    columns.map(|columns| command.env("COLUMNS", columns));
    command.output().unwrap()
}

fn text(words: &[&str], columns: Option<&str>) -> String {
    let output = anytime(words, columns);
    assert!(output.status.success(), "{words:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

fn longest(text: &str) -> usize {
    text.lines().map(|line| line.chars().count()).max().unwrap_or(0)
}

/// Every subcommand, as the help lists them.
fn commands() -> Vec<String> {
    let help = text(&["--help"], None);
    let listed = help.lines().skip_while(|line| *line != "Commands:").skip(1).take_while(|line| !line.is_empty());
    // Continuation lines of a description are indented further.
    let names = listed.filter_map(|line| line.strip_prefix("  ")?.split(' ').next().filter(|name| !name.is_empty()));
    let commands: Vec<String> = names.filter(|name| *name != "help").map(str::to_owned).collect();
    assert!(commands.len() >= 11 && commands.contains(&"replay".into()), "{commands:?}");
    commands
}

#[test]
fn help_and_tables_fit_the_terminal() {
    for columns in ["80", "60"] {
        let width: usize = columns.parse().unwrap();
        let fits = |words: &[&str]| {
            let text = text(words, Some(columns));
            assert!(longest(&text) <= width, "{words:?} at {width}: {text}");
        };
        fits(&["--help"]);
        for command in commands() {
            fits(&[&command, "--help"]);
        }
        fits(&["info", "bags/demo.bag"]);
        fits(&["evaluate", "bags/demo.tum", "--truth", "bags/demo.tum"]);
        fits(&["replay", "bags/demo.bag", "--truth", "bags/demo.tum", "--time-budget", "5ms"]);
        fits(&["localize", "bags/demo.bag", "--map", "maps/corridor.yaml", "--truth", "bags/demo.tum", "--particles", "500"]);
    }
    assert!(text(&["info", "bags/demo.bag"], None).contains("│ topic"), "a pipe has no width limit");
}

#[test]
fn no_help_text_states_a_default_twice() {
    for command in commands() {
        let help = text(&[&command, "--help"], Some("100"));
        let mut entries = vec![String::new()];
        for line in help.lines() {
            if line.trim_start().starts_with('-') {
                entries.push(String::new());
            }
            entries.last_mut().unwrap().push_str(line);
        }
        for entry in entries {
            assert!(entry.matches("default:").count() <= 1, "{command}: {entry}");
        }
    }
}

/// Keys of an object and of nested objects, joined by dots; under `failures`, `unused`, ... the names are data.
fn keys(value: &Value, path: &str, found: &mut BTreeSet<String>) {
    let data = ["failures", "unused", "chunks", "passed_over", "facts"];
    match value {
        Value::Object(fields) if !data.contains(&path) => {
            for (key, value) in fields {
                let path = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
                keys(value, &path, found);
                found.insert(path);
            }
        }
        Value::Array(values) => values.iter().for_each(|value| keys(value, path, found)),
        _ => {}
    }
}

/// The fields that docs/json.md lists for a command.
fn documented(command: &str) -> BTreeSet<String> {
    let document = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/json.md")).unwrap();
    let section = document.split("\n## ").find(|section| section.starts_with(&format!("anytime {command}\n"))).unwrap();
    let rows = section.lines().filter_map(|line| line.strip_prefix("| `"));
    rows.flat_map(|row| {
        row.split(" | ").next().unwrap().split("`, `").map(|name| name.trim_matches('`').to_owned()).collect::<Vec<_>>()
    })
    .collect()
}

#[test]
fn every_command_prints_compact_json_whose_fields_are_documented() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    std::fs::write(path("in.clf"), "FLASER 12 1 1 1 1 1 1 1 1 1 1 1 1 0 0 0 0 0 0 1 host 1\n".repeat(3)).unwrap();
    let (bag, drive, tum, csv, out) = (path("a.bag"), path("b.bag"), path("x.tum"), path("x.csv"), path("out"));
    let (clf, map) = (path("in.clf"), path("map"));
    let demo = ["bags/demo.bag", "--truth", "bags/demo.tum"];
    let lines: Vec<(&str, Vec<&str>, Vec<&str>)> = vec![
        ("replay", [&demo[..], &["--tum", &tum, "--csv", &csv]].concat(), vec!["csv", "tum"]),
        ("localize", [&demo[..], &["--map", "maps/corridor.yaml", "--particles", "500", "--csv", &csv]].concat(), vec!["csv"]),
        ("map", vec![demo[0], "--out", &map], vec!["graph", "pgm", "png", "yaml"]),
        ("drive", vec!["--world", "corridor", "--laps", "1", "--seeds", "1", "--beams", "181"], vec![]),
        ("info", vec![demo[0]], vec![]),
        ("evaluate", vec!["bags/demo.tum", "--truth", "bags/demo.tum"], vec![]),
        ("simulate", vec!["--world", "room", "--duration", "1s", "--out", &drive], vec!["out"]),
        ("convert", vec![&clf, &bag], vec!["bag"]),
        (
            "profile",
            [
                &demo[..],
                &["--out", &out, "--rounds", "1", "--knob", "beams", "--values", "128", "--variant", "projective+point_to_line"],
            ]
            .concat(),
            vec!["profile", "report", "runs", "summary"],
        ),
    ];
    for (command, arguments, files) in lines {
        let words = [&[command], &arguments[..], &["--json"]].concat();
        let printed = text(&words, Some("60"));
        assert_eq!(printed.lines().count(), 1, "{command}: the JSON must be on one line");
        let value: Value = serde_json::from_str(&printed).unwrap();
        let mut found = BTreeSet::new();
        keys(&value, "", &mut found);
        let documented = documented(command);
        let unknown: Vec<_> = found.difference(&documented).collect();
        assert!(unknown.is_empty(), "docs/json.md, {command}: {unknown:?} are missing");
        let reported = String::from_utf8(anytime(&words, None).stderr).unwrap();
        assert_eq!(reported.matches("wrote ").count(), files.len(), "{command}: {reported}");
    }
    let reported = String::from_utf8(anytime(&["replay", demo[0], "--tum", &tum], None).stderr).unwrap();
    assert!(reported.contains(&format!("wrote {tum}")), "{reported}");
    let header = std::fs::read_to_string(&csv).unwrap();
    let column = header.lines().next().unwrap().split(',').position(|name| name == "localized").expect("a column `localized`");
    assert!(header.lines().skip(1).all(|line| ["true", "false"].contains(&line.split(',').nth(column).unwrap())));
}

#[test]
fn failures_are_counted_by_reason() {
    let dir = tempfile::tempdir().unwrap();
    let csv = dir.path().join("x.csv");
    let words =
        ["replay", "bags/demo.bag", "--time-budget", "1us", "--clock", "virtual", "--json", "--csv", csv.to_str().unwrap()];
    let summary: Value = serde_json::from_str(&text(&words, None)).unwrap();
    let failures = summary["failures"].as_object().unwrap();
    let count: u64 = failures.values().map(|count| count.as_u64().unwrap()).sum();
    assert!(count > 0 && summary["failed"] == count, "{summary}");
    assert!(failures.contains_key("no_time"), "{summary}");
    let csv = std::fs::read_to_string(csv).unwrap();
    assert_eq!(csv.matches(",no_time,").count() as u64, failures["no_time"].as_u64().unwrap());
}

#[test]
fn completions_and_manual_pages_know_the_commands() {
    for shell in ["bash", "zsh", "fish"] {
        let script = text(&["completions", shell], Some("60"));
        assert!(script.contains("contract-schedule") && script.contains("localize"), "{shell}");
    }
    assert!(longest(&text(&["completions", "bash"], Some("60"))) > 60, "a script must not be wrapped");
    let page = text(&["man"], Some("60"));
    assert!(page.contains(".TH anytime 1") && page.contains("anytime\\-replay(1)"), "{page}");
    let page = text(&["man", "replay"], None);
    assert!(page.contains(".TH anytime-replay 1") && page.contains("time\\-budget"), "{page}");
    assert_eq!(anytime(&["man", "reply"], None).status.code(), Some(2));
}
