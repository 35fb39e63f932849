//! The flags that set parameters of the simulation.

use std::path::Path;

use anytime_scan_matcher::knobs::{KnobValue as _, Value};
use anytime_scan_matcher::simulation::built_in::BuiltIn;
use anytime_scan_matcher::simulation::drive::{DriveKnobs, Settings};
use anytime_scan_matcher::simulation::lidar::LidarKnobs;
use anytime_scan_matcher::simulation::odometer::OdometerKnobs;
use anytime_scan_matcher::simulation::traffic::TrafficKnobs;
use anytime_scan_matcher::simulation::vehicle::VehicleKnobs;
use clap::Args;

use crate::knob_flags::{help, set, value};
use crate::outcome::usage;

/// Rejects a `--world` that is neither built in nor a file.
pub(crate) fn check_world(name: &str) -> anyhow::Result<()> {
    match BuiltIn::from_value(&name.into()) {
        Err(expected) if !Path::new(name).exists() => {
            Err(usage(format!("--world: {expected}, and there is no map file of this name")))
        }
        _ => Ok(()),
    }
}

#[derive(Args)]
pub(crate) struct SimulationFlags {
    #[arg(long, value_parser = value, allow_hyphen_values = true, help = help::<DriveKnobs>("duration"))]
    duration: Option<Value>,
    #[arg(long, value_parser = value, allow_hyphen_values = true, help = help::<VehicleKnobs>("drive"))]
    drive: Option<Value>,
    #[arg(long, value_parser = value, allow_hyphen_values = true, help = help::<VehicleKnobs>("speed"))]
    speed: Option<Value>,
    #[arg(long, value_parser = value, allow_hyphen_values = true, help = help::<VehicleKnobs>("acceleration"))]
    acceleration: Option<Value>,
    #[arg(long, value_parser = value, allow_hyphen_values = true, help = help::<VehicleKnobs>("lateral_acceleration"))]
    lateral_acceleration: Option<Value>,
    #[arg(long, value_parser = value, allow_hyphen_values = true, help = help::<LidarKnobs>("beams"))]
    beams: Option<Value>,
    #[arg(long, value_parser = |text: &str| value(text.trim_end_matches("deg")), allow_hyphen_values = true, help = help::<LidarKnobs>("field_of_view"))]
    fov: Option<Value>,
    #[arg(long, value_parser = value, allow_hyphen_values = true, help = help::<LidarKnobs>("rate"))]
    rate: Option<Value>,
    #[arg(long, value_parser = value, allow_hyphen_values = true, help = help::<LidarKnobs>("noise"))]
    noise: Option<Value>,
    #[arg(long, value_parser = value, allow_hyphen_values = true, help = help::<LidarKnobs>("scan_duration"))]
    scan_duration: Option<Value>,
    #[arg(long, value_parser = value, allow_hyphen_values = true, help = help::<OdometerKnobs>("rate"))]
    odom_rate: Option<Value>,
    #[arg(long, value_parser = value, allow_hyphen_values = true, help = help::<TrafficKnobs>("walkers"))]
    walkers: Option<Value>,
    #[arg(long, value_parser = value, allow_hyphen_values = true, help = help::<TrafficKnobs>("rivals"))]
    rivals: Option<Value>,
}

impl SimulationFlags {
    /// The defaults, with the seed and the values set by flags.
    pub(crate) fn settings(&self, seed: u32) -> anyhow::Result<Settings> {
        let mut settings = Settings::default();
        set(&mut settings.drive, "duration", self.duration.as_ref())?;
        settings.drive.seed = seed;
        set(&mut settings.vehicle, "drive", self.drive.as_ref())?;
        set(&mut settings.vehicle, "speed", self.speed.as_ref())?;
        set(&mut settings.vehicle, "acceleration", self.acceleration.as_ref())?;
        set(&mut settings.vehicle, "lateral_acceleration", self.lateral_acceleration.as_ref())?;
        set(&mut settings.lidar, "beams", self.beams.as_ref())?;
        set(&mut settings.lidar, "field_of_view", self.fov.as_ref())?;
        set(&mut settings.lidar, "rate", self.rate.as_ref())?;
        set(&mut settings.lidar, "noise", self.noise.as_ref())?;
        set(&mut settings.lidar, "scan_duration", self.scan_duration.as_ref())?;
        set(&mut settings.odometer, "rate", self.odom_rate.as_ref())?;
        set(&mut settings.traffic, "walkers", self.walkers.as_ref())?;
        set(&mut settings.traffic, "rivals", self.rivals.as_ref())?;
        Ok(settings)
    }
}
