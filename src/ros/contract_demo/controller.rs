//! The algorithm of the demo controller.

use std::convert::Infallible;
use std::fs::File;
use std::sync::Arc;
use std::time::Duration;

use rosrust::api::Ros;

use super::ContractDemoKnobs;
use super::adherence::Adherence;
use super::contract_chooser::ContractChooser;
use super::row::Row;
use super::schedule::Schedule;
use crate::anytime::clock::Clock;
use crate::anytime::contract::{Contract, ContractError};
use crate::control::policy::Policy;
use crate::io::csv_file::CsvFile;
use crate::messages::nav_msgs::Odometry;
use crate::messages::own::{self, MatchReport};
use crate::messages::std_msgs::{Header, Int32};
use crate::ros::NodeError;
use crate::ros::context::Context;
use crate::ros::input::Input;
use crate::ros::output::Output;
use crate::ros::worker::Algorithm;

/// The demo controller: it sends contracts and checks the reports.
pub(super) struct Controller {
    clock: Arc<dyn Clock>,
    contracts: Output<own::Contract>,
    chooser: ContractChooser,
    schedule: Schedule,
    /// Speed in the last odometry message, m/s.
    speed: f64,
    adherence: Adherence,
    csv: Option<CsvFile<File, Row>>,
    /// Time of the last line in the log.
    logged: Duration,
}

impl Controller {
    pub(super) fn new(ros: &Ros, clock: &Arc<dyn Clock>, policy: Policy, knobs: &ContractDemoKnobs) -> Result<Self, NodeError> {
        Ok(Self {
            clock: Arc::clone(clock),
            contracts: Output::new(ros, "icp_contract")?,
            chooser: ContractChooser::new(policy, knobs)?,
            schedule: Schedule::default(),
            speed: 0.0,
            adherence: Adherence::default(),
            csv: knobs.csv.as_deref().map(create).transpose()?,
            logged: clock.now(),
        })
    }

    /// The topics it subscribes to.
    pub(super) fn inputs() -> Vec<Input<Self>> {
        vec![
            Input::of("icp/odom", Self::on_odometry),
            Input::of("icp_state", |controller: &mut Self, message: &Int32| {
                controller.adherence.on_state(message.data);
                Ok::<_, Infallible>(())
            }),
            Input::with_context("icp_report", |controller: &mut Self, message, _, context| {
                controller.on_report(message, context)
            })
            .required(),
        ]
    }

    fn on_odometry(&mut self, message: &Odometry) -> Result<(), &'static str> {
        let velocity = &message.twist.twist.linear;
        let speed = velocity.x.hypot(velocity.y);
        if !speed.is_finite() {
            return Err("the velocity is not finite");
        }
        self.speed = speed;
        self.chooser.on_stamp(message.header.stamp.into());
        let contract = self.chooser.contract(speed);
        if self.schedule.is_due(contract, self.clock.now()) {
            self.contracts.send(|| contract_message(&contract, &message.header));
        }
        Ok(())
    }

    fn on_report(&mut self, report: &MatchReport, context: &mut Context) -> Result<(), ContractError> {
        let in_force = Contract::new(report.time_budget.seconds(), report.translation_error_bound, report.rotation_error_bound)?;
        self.schedule.observe(in_force);
        self.chooser.set_profile_valid(report.outside_profile.is_empty());
        self.adherence.on_report(report);
        let row = Row { report: report.clone(), speed: self.speed };
        if let Some(Err(problem)) = self.csv.as_mut().map(|csv| csv.write(&row)) {
            context.reader.warn("csv", &format!("cannot write a row: {problem}"));
        }
        Ok(())
    }
}

impl Algorithm for Controller {
    /// Logs how well the contract is kept.
    fn on_timer(&mut self, context: &mut Context) {
        let now = self.clock.now();
        let time = now.saturating_sub(std::mem::replace(&mut self.logged, now));
        let budget = self.chooser.contract(self.speed).time_budget.map_or_else(|| "none".into(), |time| format!("{time:.2?}"));
        let line = self.adherence.summarize();
        context.shared.log.info(&format!("speed {:.2} m/s, time budget {budget}; last {time:.1?}: {line}", self.speed));
        if let Some(problem) = self.adherence.lost_messages() {
            context.shared.log.warn(&problem);
        }
    }

    fn end(&mut self, context: &Context) {
        context.shared.log.info(&format!("total: {}", self.adherence.total()));
    }
}

/// Describes the policy for the log.
pub(super) fn describe(policy: &Policy) -> String {
    match policy {
        Policy::BySpeed(rule) => {
            format!("time budget {:?} at rest, falling to {:?} at {} m/s and above", rule.slow, rule.fast, rule.speed_fast)
        }
        policy => format!("contracts by the policy {policy}"),
    }
}

/// Creates or truncates the CSV file. It is flushed after every row.
fn create(path: &str) -> Result<CsvFile<File, Row>, NodeError> {
    let file = File::create(path).map_err(csv::Error::from).and_then(|file| CsvFile::new(file, Row::COLUMNS));
    file.map_err(|error| NodeError::Csv { problem: format!("{path}: {error}") })
}

/// The message of a contract, with the stamp of the odometry message that it results from.
fn contract_message(contract: &Contract, header: &Header) -> own::Contract {
    own::Contract { header: Header { frame_id: String::new(), ..header.clone() }, ..contract.into() }
}
