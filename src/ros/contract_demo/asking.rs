//! What to ask of the matcher: the policy's contract for the present speed, with the bounds that the parameters name.

use std::path::Path;
use std::time::Duration;

use super::ContractDemoKnobs;
use crate::anytime::contract::{Contract, ContractError};
use crate::control::follower::FollowerKnobs;
use crate::control::policy::{BySpeed, Policy, Situation, Table};
use crate::io::profile_file::Profile;
use crate::time::Stamp;

/// Time between two scans until there have been two, and the longest that counts as one.
const PERIOD: Duration = Duration::from_millis(25);
const LONGEST_PERIOD: Duration = Duration::from_secs(1);

/// The policy that the parameters name, or what is wrong with them: which one, and how.
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
        Policy::Oracle => Err(of_policy("expected another one than oracle: nobody knows the load to come")),
        Policy::Iterations(_) => Err(of_policy("expected another one than iterations: a contract limits time and errors")),
        Policy::Table(_) => {
            let no_profile = ("profile", "expected a file for the policy table (`anytime profile` writes one)".to_owned());
            let path = knobs.profile.as_deref().ok_or(no_profile)?;
            let of_profile = |problem| ("profile", format!("{problem}"));
            let profile = Profile::load(Path::new(path)).map_err(of_profile)?;
            let variant = profile.variant(&knobs.variant).map_err(of_profile)?;
            Ok(Policy::Table(Table { modes: variant.modes(), conditions: variant.conditions }))
        }
        policy => Ok(policy),
    }
}

/// Asks.
pub(super) struct Asking {
    policy: Policy,
    bounds: Contract,
    follower: FollowerKnobs,
    last: Option<Stamp>,
    period: Duration,
    is_familiar: bool,
}

impl Asking {
    pub(super) fn new(policy: Policy, knobs: &ContractDemoKnobs) -> Result<Self, ContractError> {
        let bounds = Contract::new(0.0, knobs.translation_error_bound, knobs.rotation_error_bound)?;
        Ok(Self { policy, bounds, follower: FollowerKnobs::default(), last: None, period: PERIOD, is_familiar: true })
    }

    /// An answer of that stamp has come: so the period of the scans is known.
    pub(super) fn on_stamp(&mut self, stamp: Stamp) {
        let since = self.last.replace(stamp).map_or(0.0, |last| stamp.seconds_since(last));
        if since > 0.0 && since <= LONGEST_PERIOD.as_secs_f64() {
            self.period = Duration::from_secs_f64(since);
        }
    }

    /// Whether the scans are of the kind that the profile is of.
    pub(super) fn set_familiar(&mut self, is_familiar: bool) {
        self.is_familiar = is_familiar;
    }

    /// The contract at `speed`, m/s. Of the room beside the robot nothing is known, and its follower is taken to make up for delays.
    pub(super) fn contract(&self, speed: f64) -> Contract {
        let lookahead = self.follower.lookahead(speed);
        let situation = Situation {
            speed,
            lookahead,
            clearance: f64::INFINITY,
            uncompensated_turn: 0.0,
            period: self.period,
            is_familiar: self.is_familiar,
            whole: Duration::ZERO,
        };
        let asked = self.policy.terms(&situation).contract;
        Contract {
            time_budget: asked.time_budget,
            translation_error_bound: self.bounds.translation_error_bound.or(asked.translation_error_bound),
            rotation_error_bound: self.bounds.rotation_error_bound.or(asked.rotation_error_bound),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asking(name: Option<&str>) -> Asking {
        let knobs =
            ContractDemoKnobs { policy: name.map(Into::into), translation_error_bound: 0.02, ..ContractDemoKnobs::default() };
        Asking::new(policy(&knobs).unwrap(), &knobs).unwrap()
    }

    #[test]
    fn the_parameters_name_the_policy_and_the_bounds() {
        let at = |name, speed| asking(name).contract(speed);
        let contract = at(None, 1.0);
        assert_eq!((contract.time_budget, contract.rotation_error_bound), (Some(Duration::from_millis(8)), None));
        assert_eq!(contract.translation_error_bound, Some(0.02));
        assert_eq!(at(Some("fixed:5ms"), 1.0).time_budget, Some(Duration::from_millis(5)));
        assert_eq!(at(Some("completion"), 1.0).time_budget, None);
    }

    #[test]
    fn what_a_live_matcher_cannot_do_is_refused() {
        for (name, parameter) in [("oracle", "policy"), ("iterations:3", "policy"), ("slowly", "policy"), ("table", "profile")] {
            let knobs = ContractDemoKnobs { policy: Some(name.into()), ..ContractDemoKnobs::default() };
            assert_eq!(policy(&knobs).unwrap_err().0, parameter, "{name}");
        }
    }
}
