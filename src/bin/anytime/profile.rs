//! `anytime profile`.

use std::path::{Path, PathBuf};

use anytime_scan_matcher::config::Config;
use anytime_scan_matcher::io::bag::{Bag, Compression};
use anytime_scan_matcher::io::{map_file, simulated_bag};
use anytime_scan_matcher::messages::geometry_msgs::PoseStamped;
use anytime_scan_matcher::messages::nav_msgs::Odometry;
use anytime_scan_matcher::profile::plan::Plan;
use anytime_scan_matcher::profile::run::StudyData;
use anytime_scan_matcher::profile::study::{Names, Study};
use anytime_scan_matcher::replay::truth;
use serde_json::json;

use crate::files::{Files, create_folder};
use crate::outcome::usage;
use crate::profile_flags::Arguments;
use crate::{progress, simulate, terminal};

pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<String> {
    let Arguments { out, input, .. } = arguments;
    let mut config = input.configuration.load()?;
    input.clock.prepare(&mut config);
    check_files(arguments, &config)?;
    let map = arguments.map.as_deref().map(map_file::read).transpose()?;
    let plan = Plan::new(&config, &arguments.variants()?, &arguments.sweeps()?, arguments.rounds, arguments.seed)?;
    create_folder(out)?;
    let path = bag_path(arguments)?;
    let bag = Bag::open(&path)?;
    let topics = input.topics(&bag, &config)?;
    let truth_name = truth_name(arguments, &bag)?;
    let truth = truth::load(&truth_name, &bag)?;
    let new_clock = || input.clock.clock();
    let study = Study {
        input: StudyData { bag: &bag, topics: &topics, truth: &truth, map: map.as_ref() },
        config: &config,
        plan: &plan,
        deltas: &arguments.delta,
        new_clock: &new_clock,
        names: Names {
            bag: path.display().to_string(),
            truth: truth_name,
            clock: input.clock.name().into(),
            command: terminal::command_line(),
        },
    };
    let progress = progress::bar(bag.message_count(Some(&topics.all())) * study.runs() as u64)?;
    progress.println(format!("{} cases in {} rounds: {} runs", plan.cases.len(), plan.rounds, study.runs()));
    let results = study.conduct(out, || progress.inc(1))?;
    progress.finish_and_clear();
    let problems: Vec<String> = bag.problems().iter().map(ToString::to_string).collect();
    let [report, profile, summary, runs] = ["report.html", "profile.yaml", "summary.csv", "runs.csv"].map(|name| out.join(name));
    let files = Files::default()
        .written("report", Some(&report))
        .written("profile", Some(&profile))
        .written("summary", Some(&summary))
        .written("runs", Some(&runs));
    let value = || {
        let (look_up, comparisons) = results.tables_to_json();
        json!({
            "cases": plan.cases.len(),
            "rounds": plan.rounds,
            "runs": study.runs(),
            "look_up_tables": look_up,
            "comparisons": comparisons,
            "bag_problems": problems,
        })
    };
    let damage = || problems.iter().flat_map(|problem| ["\nwarning: the bag is damaged: ", problem]).collect::<String>();
    let cases = plan.cases.len();
    Ok(files.output(arguments.json, value, || {
        format!(
            "{}\n{cases} cases in {} rounds: {} runs{}\nwrote the plots in {}",
            results.to_text(terminal::width()),
            plan.rounds,
            study.runs(),
            damage(),
            out.display()
        )
    }))
}

/// The files that a study writes besides plots and the tables of scans.
const WRITTEN: [&str; 6] = ["runs.csv", "summary.csv", "profile.yaml", "report.html", "drive.bag", "drive.tum"];

fn check_files(arguments: &Arguments, config: &Config) -> anyhow::Result<()> {
    let written = WRITTEN.map(|name| arguments.out.join(name));
    let simulated = if arguments.world.is_some() { 0 } else { 2 };
    let files = Files::default()
        .with_flags(&arguments.input, config)
        .read("contract.cost_file", config.contract.cost_file.as_deref().map(Path::new))
        .read("the bag", arguments.bag.as_deref())
        .read_map("--world", arguments.world.as_deref().map(Path::new))
        .read_map("--map", arguments.map.as_deref());
    let written = written.iter().take(WRITTEN.len() - simulated);
    written.fold(files, |files, path| files.written("a file of --out", Some(path))).check()
}

/// The given bag, or that of the simulated drive.
fn bag_path(arguments: &Arguments) -> anyhow::Result<PathBuf> {
    let Some(world) = &arguments.world else { return Ok(arguments.bag.clone().unwrap_or_default()) };
    let path = arguments.out.join("drive.bag");
    let settings = arguments.simulation.settings(arguments.seed)?;
    simulate::drive(world, &settings, &path, Compression::Lz4, Some(&arguments.out.join("drive.tum")))?;
    Ok(path)
}

fn truth_name(arguments: &Arguments, bag: &Bag) -> anyhow::Result<String> {
    match &arguments.input.truth {
        Some(name) => Ok(name.clone()),
        None if arguments.world.is_some() => Ok(simulated_bag::TRUTH_TOPIC.into()),
        None => {
            let candidates = [bag.topics_of::<PoseStamped>(), bag.topics_of::<Odometry>()].concat();
            let candidates = if candidates.is_empty() { "none".into() } else { candidates.join(", ") };
            Err(usage(format!(
                "the true poses are missing: use --truth FILE.tum, or --truth TOPIC with a topic of the bag (topics with poses: {candidates})"
            )))
        }
    }
}
