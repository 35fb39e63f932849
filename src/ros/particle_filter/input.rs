//! Inputs of the node.

use crate::config::Config;
use crate::messages::geometry_msgs::{PointStamped, PoseWithCovarianceStamped};
use crate::messages::nav_msgs::{OccupancyGrid, Odometry};
use crate::messages::own::Contract;
use crate::messages::sensor_msgs::{LaserScan, PointCloud2};
use crate::messages::std_msgs::Empty;
use crate::messages::tf2_msgs::TFMessage;
use crate::ros::sink::Topic;
use crate::ros::worker::NodeInput;

/// A topic the node listens to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::ros) enum Input {
    Scan,
    Cloud,
    Odometry,
    Map,
    InitialPose,
    ClickedPoint,
    Contract,
    Interrupt,
    Transforms,
    StaticTransforms,
}

impl Input {
    const ALL: [Self; 10] = [
        Self::Scan,
        Self::Cloud,
        Self::Odometry,
        Self::Map,
        Self::InitialPose,
        Self::ClickedPoint,
        Self::Contract,
        Self::Interrupt,
        Self::Transforms,
        Self::StaticTransforms,
    ];

    /// All that the node listens to: of scans and clouds those that are wanted.
    pub(super) fn wanted(config: &Config) -> impl Iterator<Item = Self> {
        let other = if config.cloud.input { Self::Scan } else { Self::Cloud };
        Self::ALL.into_iter().filter(move |input| *input != other)
    }
}

impl NodeInput for Input {
    fn topic(self) -> Topic {
        match self {
            Self::Scan => Topic::vital::<LaserScan>("scan"),
            Self::Cloud => Topic::vital::<PointCloud2>("cloud"),
            Self::Odometry => Topic::of::<Odometry>("odom"),
            Self::Map => Topic::of::<OccupancyGrid>("map"),
            Self::InitialPose => Topic::of::<PoseWithCovarianceStamped>("initialpose"),
            Self::ClickedPoint => Topic::of::<PointStamped>("clicked_point"),
            Self::Contract => Topic::of::<Contract>("icp_contract"),
            Self::Interrupt => Topic::of::<Empty>("icp_interrupt"),
            Self::Transforms => Topic::of::<TFMessage>("/tf"),
            Self::StaticTransforms => Topic::of::<TFMessage>("/tf_static"),
        }
    }
}
