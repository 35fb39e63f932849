//! The scan matcher as a whole: puts the parts together.

use std::sync::Arc;

use rosrust::api::{Master, Ros};

use super::compat::{self, Face};
use super::diagnostics::{Diagnostics, Monitor, Task};
use super::input::Input;
use super::interrupts::Interrupts;
use super::live_params::{Change, ParameterWatch};
use super::log::Log;
use super::mailbox::{Event, Mailbox};
use super::mapper::{self, Mapping};
use super::master::{MasterLink, resolved};
use super::matcher::Matcher;
use super::publishers::Publishers;
use super::shutdown::StopSignal;
use super::subscriptions::Subscriptions;
use super::supervisor::{self, Parts, Supervisor};
use super::transform_output::TransformOutput;
use super::worker::{NodeInput as _, Shared, Worker, subscribe};
use super::{NodeError, params, services, shell};
use crate::anytime::clock::{Clock, MonotonicClock};
use crate::anytime::contract::Contract;
use crate::app::App;
use crate::config::{Config, FrameKnobs};

const NAME: &str = "scan_matcher";
/// The service that starts again, and what it answers.
const RESET: (&str, &str) = ("~reset", "the next scan is the first one, at the initial pose");
const TASK: Task = Task { title: "scan matching", doing: "matching", done: "matched" };

/// Runs the node `scan_matcher` until SIGINT, SIGTERM or the master ends it. The arguments of the process are ROS's: remappings and
/// parameters.
pub fn run() -> Result<(), NodeError> {
    shell::run(NAME, |ros, master, stop| {
        let config = params::read(master, ros.name())?;
        serve(ros, master, stop, &config, &Face::native(&config), |_, _, _| Ok(None))
    })
}

/// The same with the parameters and the topics of `laser_scan_matcher`, in whose place it can be put.
pub fn run_as_laser_scan_matcher() -> Result<(), NodeError> {
    shell::run(NAME, |ros, master, stop| {
        let (config, face) = compat::read(master, ros.name())?;
        serve(ros, master, stop, &config, &face, |_, _, _| Ok(None))
    })
}

/// The same with a map of what it has seen: the node `mapper`.
pub fn run_mapper() -> Result<(), NodeError> {
    shell::run("mapper", |ros, master, stop| {
        let mut config = params::read(master, ros.name())?;
        mapper::prepare(ros.name(), &mut config)?;
        stop.hold(config.mapping.save_on_exit);
        let mapping = |clock: &_, monitor: &_, log: &_| Mapping::start(ros, &config, clock, monitor, log).map(Some);
        let outcome = serve(ros, master, stop, &config, &Face::native(&config), mapping);
        stop.hold(false);
        outcome
    })
}

/// The scan matcher; `mapping` starts a map beside it, or none.
fn serve(
    ros: &Ros,
    master: &Master,
    stop: &StopSignal,
    config: &Config,
    face: &Face,
    mapping: impl FnOnce(&Arc<dyn Clock>, &Arc<Monitor>, &Log) -> Result<Option<Mapping>, NodeError>,
) -> Result<(), NodeError> {
    let log = Log::new(ros)?;
    if !face.ignored.is_empty() {
        log.warn(&format!("these parameters mean nothing here and are ignored: {}", face.ignored.join(", ")));
    }
    config.warnings().iter().for_each(|warning| log.warn(warning));
    let transform = Arc::new(TransformOutput::default());
    transform.switch(ros, &config.frames.base_frame, config.frames.publish_tf)?;
    transform.switch(ros, &config.frames.odom_frame, config.frames.publish_map_tf)?;
    let (clock, monitor): (Arc<dyn Clock>, _) = (Arc::new(MonotonicClock::default()), Arc::new(Monitor::default()));
    let mut mapping = mapping(&clock, &monitor, &log)?;
    let parts = start(ros, config, face, (clock, monitor, &log), &transform, mapping.as_mut())?;
    let mut changes = Changes {
        watch: ParameterWatch::new(master, ros.name(), config)?,
        mailbox: Arc::clone(&parts.mailbox),
        transform,
        ros,
        log: log.clone(),
    };
    let supervisor = Supervisor::new(ros, master, parts, &log)?;
    announce(ros, &log, config)?;
    supervisor.run(stop, |master| changes.look(master));
    if let Some(mapping) = mapping {
        mapping.end();
    }
    Ok(())
}

fn start<'a>(
    ros: &'a Ros,
    config: &Config,
    face: &Face,
    (clock, monitor, log): (Arc<dyn Clock>, Arc<Monitor>, &Log),
    transform: &Arc<TransformOutput>,
    mapping: Option<&mut Mapping>,
) -> Result<Parts<'a, Input>, NodeError> {
    let mailbox = Arc::new(Mailbox::default());
    let interrupts = Arc::new(Interrupts::new(config.contract.shared_memory.as_deref())?);
    let mut app = App::new(config, Arc::clone(&clock))?;
    app.warm_up()?;
    app.set_interrupt(Arc::clone(&interrupts) as Arc<_>);
    let publishers = Publishers::new(ros, Arc::clone(transform), face)?;
    let diagnostics = Diagnostics::new(ros, TASK)?;
    let mut registrations = publishers.registrations();
    registrations.extend(face.inputs.iter().map(|input| input.topic().registration()));

    let (save_profile, replies) = services::save_profile(ros, &mailbox)?;
    let mut services = vec![services::reset(ros, RESET, &mailbox)?, save_profile];
    let mut feed = None;
    if let Some(mapping) = mapping {
        services.append(&mut mapping.services);
        registrations.append(&mut mapping.registrations);
        feed = mapping.feed.take();
    }
    let shared = Shared {
        mailbox: Arc::clone(&mailbox),
        interrupts: Arc::clone(&interrupts),
        clock: Arc::clone(&clock),
        monitor: Arc::clone(&monitor),
        log: log.clone(),
        takes_clouds: config.cloud.input,
    };
    let matcher = Matcher::new(app, publishers, replies, feed);
    let worker = supervisor::spawn("matching", || Worker::new(matcher, shared).run(None))?;
    let subscriptions = Subscriptions::new(ros, &clock, log)?;
    face.inputs.iter().try_for_each(|&input| subscribe(&subscriptions, input, &mailbox, &interrupts))?;
    Ok(Parts { clock, mailbox, monitor, diagnostics, worker, subscriptions, services, registrations })
}

/// Parameters that are changed while the node runs.
struct Changes<'a> {
    watch: ParameterWatch<'a>,
    mailbox: Arc<Mailbox<Input>>,
    transform: Arc<TransformOutput>,
    ros: &'a Ros,
    log: Log,
}

impl Changes<'_> {
    fn look(&mut self, master: &mut MasterLink) {
        for (name, change) in self.watch.look() {
            match change.and_then(|change| self.apply(change, master)) {
                Ok(()) => self.log.info(&format!("parameter {name}: in force from now on")),
                Err(problem) => self.log.error(&format!("parameter {name}: no effect: {problem}")),
            }
        }
    }

    fn apply(&self, change: Change, master: &mut MasterLink) -> Result<(), String> {
        match change {
            Change::Matching(change) => self.mailbox.put_event(Event::Change(change)),
            Change::PublishTransform { child, on } => {
                self.transform.switch(self.ros, &child, on).map_err(|error| error.to_string())?;
                self.transform.registration().into_iter().for_each(|registration| master.add(registration));
            }
        }
        Ok(())
    }
}

/// Says that the node is ready, and what for.
fn announce(ros: &Ros, log: &Log, config: &Config) -> Result<(), NodeError> {
    let contract = Contract::try_from(&config.contract)?;
    let [scan, odometry, pose] =
        [if config.cloud.input { "cloud" } else { "scan" }, "odom", "scan_match_location"].map(|topic| resolved(ros, topic));
    let frames = &config.frames;
    log.info(&format!(
        "matches {} with {} to {} ({} -> {}; {}), {}, by {} + {}",
        scan?,
        odometry?,
        pose?,
        frames.map_frame,
        frames.base_frame,
        transforms(frames),
        describe(&contract),
        config.matching.correspondence.name(),
        config.matching.solver.name(),
    ));
    Ok(())
}

/// What is said on `/tf`, in words.
fn transforms(frames: &FrameKnobs) -> String {
    let [map, odom, base] = [&frames.map_frame, &frames.odom_frame, &frames.base_frame];
    match (frames.publish_map_tf, frames.publish_tf) {
        (true, true) => format!("{map} -> {odom} -> {base} on /tf"),
        (true, false) => format!("{map} -> {odom} on /tf"),
        (false, true) => format!("{odom} -> {base} on /tf"),
        (false, false) => "nothing on /tf".into(),
    }
}

/// A contract in words.
pub(super) fn describe(contract: &Contract) -> String {
    let limits: Vec<String> = [
        contract.time_budget.map(|budget| format!("within {budget:?}")),
        contract.translation_error_bound.map(|bound| format!("to {bound} m")),
        contract.rotation_error_bound.map(|bound| format!("to {bound} rad")),
    ]
    .into_iter()
    .flatten()
    .collect();
    if limits.is_empty() { "to completion".into() } else { limits.join(", ") }
}
