//! The controller on the ROS graph.

use std::fs::File;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Duration;

use rosrust::api::{Master, Ros};

use super::ContractDemoKnobs;
use super::adherence::Adherence;
use super::asking::Asking;
use super::row::Row;
use super::schedule::Schedule;
use crate::anytime::clock::{Clock, MonotonicClock};
use crate::anytime::contract::Contract;
use crate::control::policy::Policy;
use crate::io::csv_file::CsvFile;
use crate::messages::Message as _;
use crate::messages::nav_msgs::Odometry;
use crate::messages::own::{self, MatchReport};
use crate::messages::std_msgs::{Header, Int32};
use crate::ros::NodeError;
use crate::ros::log::Log;
use crate::ros::master::{MasterLink, MasterRegistration};
use crate::ros::output::Output;
use crate::ros::reader::Reader;
use crate::ros::shutdown::StopSignal;
use crate::ros::sink::{RawMessage, Topic};
use crate::ros::subscriptions::Subscriptions;

/// How often the node looks whether it is to stop.
const TICK: Duration = Duration::from_millis(100);
/// How often it looks after the master.
const MASTER_PERIOD: Duration = Duration::from_secs(1);

/// Its inputs.
#[derive(Clone, Copy, Debug)]
enum Input {
    Odometry,
    State,
    Report,
}

impl Input {
    const ALL: [Self; 3] = [Self::Odometry, Self::State, Self::Report];

    fn topic(self) -> Topic {
        match self {
            Self::Odometry => Topic::of::<Odometry>("icp/odom"),
            Self::State => Topic::of::<Int32>("icp_state"),
            Self::Report => Topic::vital::<MatchReport>("icp_report"),
        }
    }
}

pub(super) struct Controller<'a> {
    ros: &'a Ros,
    clock: Arc<dyn Clock>,
    master: MasterLink<'a>,
    received: Receiver<(Input, RawMessage)>,
    contracts: Output<own::Contract>,
    asking: Asking,
    schedule: Schedule,
    /// Of the last message, m/s.
    speed: f64,
    adherence: Adherence,
    csv: Option<CsvFile<File, Row>>,
    log_period: Duration,
    log: Log,
    reader: Reader,
    // Dropping this ends them.
    _subscriptions: Subscriptions<'a>,
}

impl<'a> Controller<'a> {
    pub(super) fn start(ros: &'a Ros, master: &'a Master, policy: Policy, knobs: &ContractDemoKnobs) -> Result<Self, NodeError> {
        let log = Log::new(ros)?;
        let clock: Arc<dyn Clock> = Arc::new(MonotonicClock::default());
        let in_words = in_words(&policy);
        let asking = Asking::new(policy, knobs)?;
        let csv = knobs.csv.as_deref().map(create).transpose()?;
        let contracts = Output::new(ros, "icp_contract")?;
        let (sender, received) = channel();
        let subscriptions = Subscriptions::new(ros, &clock, &log)?;
        Input::ALL.into_iter().try_for_each(|input| subscribe(&subscriptions, input, sender.clone()))?;
        let mut registrations: Vec<MasterRegistration> = Input::ALL.map(|input| input.topic().registration()).into();
        registrations.extend([contracts.registration(), MasterRegistration::ROSOUT]);
        let master = MasterLink::new(ros, master, registrations, &log)?;
        log.info(&in_words);
        let reader = Reader::new(&clock, &log);
        Ok(Self {
            ros,
            clock,
            master,
            received,
            contracts,
            asking,
            schedule: Schedule::default(),
            speed: 0.0,
            adherence: Adherence::default(),
            csv,
            log_period: Duration::from_secs_f64(knobs.log_period.0),
            log,
            reader,
            _subscriptions: subscriptions,
        })
    }

    /// Runs until it is told to stop.
    pub(super) fn run(mut self, stop: &StopSignal) {
        let (mut looked, mut logged) = (self.clock.now(), self.clock.now());
        while !stop.wait(Duration::ZERO) && self.ros.is_ok() {
            if let Ok((input, raw)) = self.received.recv_timeout(TICK) {
                self.handle(input, &raw);
            }
            let now = self.clock.now();
            if now.saturating_sub(looked) >= MASTER_PERIOD {
                looked = now;
                self.master.check();
            }
            if now.saturating_sub(logged) >= self.log_period {
                self.report(now.saturating_sub(logged));
                logged = now;
            }
        }
        self.log.info(&format!("in all: {}", self.adherence.total()));
    }

    fn handle(&mut self, input: Input, raw: &RawMessage) {
        match input {
            Input::Odometry => {
                if let Some(message) = self.reader.read(Odometry::TYPE, raw) {
                    self.on_odometry(&message);
                }
            }
            Input::State => {
                if let Some(message) = self.reader.read::<Int32>(Int32::TYPE, raw) {
                    self.adherence.on_state(message.data);
                }
            }
            Input::Report => {
                if let Some(message) = self.reader.read(MatchReport::TYPE, raw) {
                    self.on_report(&message);
                }
            }
        }
    }

    fn on_odometry(&mut self, message: &Odometry) {
        let velocity = &message.twist.twist.linear;
        let speed = velocity.x.hypot(velocity.y);
        if !speed.is_finite() {
            return self.reader.warn("icp/odom", "the velocity has numbers that are not finite");
        }
        self.speed = speed;
        self.asking.on_stamp(message.header.stamp.into());
        let contract = self.asking.contract(speed);
        if self.schedule.is_due(contract, self.clock.now()) {
            self.contracts.send(|| contract_message(&contract, &message.header));
        }
    }

    fn on_report(&mut self, report: &MatchReport) {
        let in_force = Contract::new(report.time_budget.seconds(), report.translation_error_bound, report.rotation_error_bound);
        match in_force {
            Ok(contract) => self.schedule.observe(contract),
            Err(error) => return self.reader.warn("icp_report", &error.to_string()),
        }
        self.asking.set_familiar(report.outside_profile.is_empty());
        self.adherence.on_report(report);
        let row = Row { report: report.clone(), speed: self.speed };
        if let Some(Err(problem)) = self.csv.as_mut().map(|csv| csv.write(&row)) {
            self.reader.warn("csv", &format!("a row is lost: {problem}"));
        }
    }

    fn report(&mut self, time: Duration) {
        let budget = self.asking.contract(self.speed).time_budget.map_or_else(|| "none".into(), |time| format!("{time:.2?}"));
        let line = self.adherence.sum_up();
        self.log.info(&format!("{:.2} m/s, budget {budget}; in {time:.1?}: {line}", self.speed));
        if let Some(problem) = self.adherence.disagreement() {
            self.log.warn(&problem);
        }
    }
}

/// What it will do.
fn in_words(policy: &Policy) -> String {
    match policy {
        Policy::BySpeed(rule) => {
            format!("gives scans {:?} at rest and {:?} at {} m/s and beyond", rule.slow, rule.fast, rule.speed_fast)
        }
        policy => format!("gives scans contracts by the policy {policy}"),
    }
}

fn subscribe(subscriptions: &Subscriptions, input: Input, sender: Sender<(Input, RawMessage)>) -> Result<(), NodeError> {
    // Nobody listens any more when the node is ending.
    subscriptions.listen(input.topic(), move |raw| drop(sender.send((input, raw))))
}

/// Makes the CSV file anew; it is whole after every row.
fn create(path: &str) -> Result<CsvFile<File, Row>, NodeError> {
    let file = File::create(path).map_err(csv::Error::from).and_then(|file| CsvFile::new(file, Row::COLUMNS));
    file.map_err(|error| NodeError::Csv { problem: format!("{path}: {error}") })
}

/// With the header of the odometry that it follows from.
fn contract_message(contract: &Contract, header: &Header) -> own::Contract {
    own::Contract { header: Header { frame_id: String::new(), ..header.clone() }, ..contract.into() }
}
