//! Chooses the contract: that of the policy for the current speed, with the error bounds from the parameters.

use std::path::Path;
use std::time::Duration;

use super::ContractDemoKnobs;
use crate::anytime::contract::{Contract, ContractError};
use crate::control::follower::FollowerKnobs;
use crate::control::policy::{BySpeed, Policy, Situation, Table};
use crate::io::profile_file::Profile;
use crate::time::Stamp;

/// Assumed scan period until two scans have arrived.
const DEFAULT_PERIOD: Duration = Duration::from_millis(25);
/// Maximum time between two scans that counts as the scan period.
const MAX_PERIOD: Duration = Duration::from_secs(1);

/// The policy given by the parameters. On an error: the name of the invalid parameter and the problem.
pub(super) fn policy(knobs: &ContractDemoKnobs) -> Result<Policy, (&'static str, String)> {
    let (slow, fast) = (knobs.budget_slow.0, knobs.budget_fast.0);
    if fast > slow {
        return Err(("budget_fast", format!("expected at most budget_slow, {slow}, got {fast}")));
    }
    let [slow, fast] = [slow, fast].map(Duration::from_secs_f64);
    let by_speed = Policy::BySpeed(BySpeed { slow, fast, speed_fast: knobs.speed_fast });
    let Some(name) = &knobs.policy else { return Ok(by_speed) };
    let of_policy = |problem: &str| ("policy", problem.to_owned());
    match name.parse().map_err(|problem| ("policy", format!("{problem}")))? {
        Policy::Oracle => {
            Err(of_policy("'oracle' works only in simulation, where the future load is known: choose another policy"))
        }
        Policy::Iterations(_) => {
            Err(of_policy("'iterations' works only offline, since a contract limits time and errors: choose another policy"))
        }
        Policy::Table(_) => {
            let no_profile = ("profile", "the policy 'table' needs a profile (`anytime profile` writes one)".to_owned());
            let path = knobs.profile.as_deref().ok_or(no_profile)?;
            let of_profile = |problem| ("profile", format!("{problem}"));
            let profile = Profile::load(Path::new(path)).map_err(of_profile)?;
            let variant = profile.variant(&knobs.variant).map_err(of_profile)?;
            Ok(Policy::Table(Table { modes: variant.modes(), conditions: variant.conditions }))
        }
        policy => Ok(policy),
    }
}

/// Chooses contracts.
pub(super) struct ContractChooser {
    policy: Policy,
    bounds: Contract,
    follower: FollowerKnobs,
    last: Option<Stamp>,
    period: Duration,
    is_profile_valid: bool,
}

impl ContractChooser {
    pub(super) fn new(policy: Policy, knobs: &ContractDemoKnobs) -> Result<Self, ContractError> {
        let bounds = Contract::new(0.0, knobs.translation_error_bound, knobs.rotation_error_bound)?;
        Ok(Self {
            policy,
            bounds,
            follower: FollowerKnobs::default(),
            last: None,
            period: DEFAULT_PERIOD,
            is_profile_valid: true,
        })
    }

    /// Updates the scan period by the stamp of an answer.
    pub(super) fn on_stamp(&mut self, stamp: Stamp) {
        let since = self.last.replace(stamp).map_or(0.0, |last| stamp.seconds_since(last));
        if since > 0.0 && since <= MAX_PERIOD.as_secs_f64() {
            self.period = Duration::from_secs_f64(since);
        }
    }

    /// Sets whether the scans resemble those that the profile was made from.
    pub(super) fn set_profile_valid(&mut self, is_profile_valid: bool) {
        self.is_profile_valid = is_profile_valid;
    }

    /// The contract at `speed`, m/s. The clearance beside the robot is unknown, and its path follower is assumed to compensate
    /// delays.
    pub(super) fn contract(&self, speed: f64) -> Contract {
        let lookahead = self.follower.lookahead(speed);
        let situation = Situation {
            speed,
            lookahead,
            clearance: f64::INFINITY,
            uncompensated_yaw_rate: 0.0,
            period: self.period,
            is_profile_valid: self.is_profile_valid,
            full_answer_time: Duration::ZERO,
        };
        let chosen = self.policy.terms(&situation).contract;
        Contract {
            time_budget: chosen.time_budget,
            translation_error_bound: self.bounds.translation_error_bound.or(chosen.translation_error_bound),
            rotation_error_bound: self.bounds.rotation_error_bound.or(chosen.rotation_error_bound),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::knobs::KnobGroup as _;

    fn chooser(name: Option<&str>) -> ContractChooser {
        let knobs =
            ContractDemoKnobs { policy: name.map(Into::into), translation_error_bound: 0.02, ..ContractDemoKnobs::default() };
        ContractChooser::new(policy(&knobs).unwrap(), &knobs).unwrap()
    }

    #[test]
    fn the_parameters_set_the_policy_and_the_bounds() {
        let at = |name, speed| chooser(name).contract(speed);
        let contract = at(None, 1.0);
        assert_eq!((contract.time_budget, contract.rotation_error_bound), (Some(Duration::from_millis(8)), None));
        assert_eq!(contract.translation_error_bound, Some(0.02));
        assert_eq!(at(Some("fixed:5ms"), 1.0).time_budget, Some(Duration::from_millis(5)));
        assert_eq!(at(Some("completion"), 1.0).time_budget, None);
    }

    #[test]
    fn the_help_writes_the_policies_as_their_error_message_does() {
        let table = ContractDemoKnobs::default().table();
        let help = table.iter().find(|knob| knob.name == "policy").unwrap().help;
        let error = "slowly".parse::<Policy>().unwrap_err().to_string();
        for form in ["completion", "fixed:TIME[,METRES]", "by_speed:SLOW,FAST,SPEED", "table"] {
            assert!(help.contains(form) && error.contains(form), "{form}: {help} {error}");
        }
    }

    #[test]
    fn policies_that_cannot_work_live_are_rejected() {
        for (name, parameter) in [("oracle", "policy"), ("iterations:3", "policy"), ("slowly", "policy"), ("table", "profile")] {
            let knobs = ContractDemoKnobs { policy: Some(name.into()), ..ContractDemoKnobs::default() };
            assert_eq!(policy(&knobs).unwrap_err().0, parameter, "{name}");
        }
    }
}
