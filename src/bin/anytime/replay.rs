//! `anytime replay`.

use std::path::Path;
use std::sync::Arc;

use anytime_scan_matcher::app::App;
use anytime_scan_matcher::config::Config;
use anytime_scan_matcher::evaluation::consistency::Consistency;
use anytime_scan_matcher::evaluation::plot::trajectory_plot;
use anytime_scan_matcher::evaluation::report::{Comparison, Report};
use anytime_scan_matcher::evaluation::trajectory::Trajectory;
use anytime_scan_matcher::io::bag::Bag;
use anytime_scan_matcher::io::contract_schedule;
use anytime_scan_matcher::replay::recorder::{OutputFiles, RecordError, Recorder};
use anytime_scan_matcher::replay::summary::Ending;
use anytime_scan_matcher::replay::{Source, replay, truth};

use crate::files::Files;
use crate::outcome::output_or_failure;
use crate::replay_flags::Arguments;
use crate::{progress, terminal};

pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<String> {
    let mut config = arguments.input.configuration.load()?;
    if let Some(budget) = &arguments.time_budget {
        config.set("contract.time_budget", budget, "--time-budget")?;
    }
    files(arguments, &config).check()?;
    let bag = Bag::open(&arguments.bag)?;
    let topics = arguments.input.topics(&bag, &config)?;
    let truth = arguments.input.truth.as_deref().map(|name| truth::load(name, &bag)).transpose()?;
    let clock = arguments.input.clock.clock();
    let mut app = App::new(&config, Arc::clone(&clock))?;
    app.warm_up()?;
    let files = OutputFiles { tum: arguments.tum.clone(), csv: arguments.csv.clone() };
    let mut recorder = Recorder::create(files, arguments.plot.is_some())?;
    let progress = progress::bar(bag.message_count(Some(&topics.all())))?;
    let tick = || progress.inc(1);
    let schedule = arguments.contract_schedule.as_deref().map(contract_schedule::read).transpose()?.unwrap_or_default();
    let source = Source { bag: &bag, topics: &topics, schedule: &schedule };
    let log = replay::<RecordError>(&source, &mut app, &*clock, tick, |scan, estimate, app| recorder.add(scan, estimate, app))?;
    progress.finish_and_clear();
    if recorder.summary().poses().is_empty() {
        anyhow::bail!("{}: no scan on {} could be read{}", arguments.bag.display(), topics.scan, log.reasons(&bag, &[]));
    }
    recorder.finish()?;
    app.store_costs()?;
    let summary = recorder.summary();
    let trajectory = Trajectory::new(summary.poses().to_vec())?;
    let report = truth.as_ref().map(|truth| Report::new(&trajectory, Some(truth), None, Comparison::default())).transpose()?;
    let max_dt = Comparison::default().max_dt;
    let consistency = truth.as_ref().and_then(|truth| Consistency::new(summary.uncertain_poses(), truth, max_dt));
    if let Some(path) = &arguments.plot {
        trajectory_plot(path, &trajectory, truth.as_ref(), recorder.points(), max_dt)?;
    }
    let ending = Ending {
        log,
        counters: *app.odometry_counters(),
        odometry_lag: app.odometry_lag(),
        mount_source: app.mount().1,
        report,
        consistency,
        bag_problems: bag.problems().iter().map(ToString::to_string).collect(),
    };
    let files = self::files(arguments, &config);
    let text = files.output(arguments.json, || summary.to_json(&ending), || summary.to_text(&ending, terminal::width()));
    output_or_failure(text, summary.failure().map(|problem| format!("{}: {problem}", arguments.bag.display())))
}

fn files<'a>(arguments: &'a Arguments, config: &'a Config) -> Files<'a> {
    Files::default()
        .with_flags(&arguments.input, config)
        .read("the bag", Some(&arguments.bag))
        .read("--contract-schedule", arguments.contract_schedule.as_deref())
        .written("contract.cost_file", config.contract.cost_file.as_deref().map(Path::new))
        .written("--tum", arguments.tum.as_deref())
        .written("--csv", arguments.csv.as_deref())
        .written("--plot", arguments.plot.as_deref())
}
