// The least that a node of roscpp can do with a scan: a pose of the same stamp.

#include <boost/function.hpp>
#include <geometry_msgs/PoseStamped.h>
#include <ros/ros.h>
#include <sensor_msgs/LaserScan.h>

int main(int argc, char **argv) {
  using Scan = sensor_msgs::LaserScan;
  ros::init(argc, argv, "echo");
  ros::NodeHandle node;
  ros::Publisher poses = node.advertise<geometry_msgs::PoseStamped>("echo", 100);
  const boost::function<void(const Scan::ConstPtr &)> answer = [&poses](const Scan::ConstPtr &scan) {
    geometry_msgs::PoseStamped pose;
    pose.header = scan->header;
    pose.pose.orientation.w = 1.0;
    poses.publish(pose);
  };
  const auto hints = ros::TransportHints().tcpNoDelay();
  const ros::Subscriber scans = node.subscribe<Scan>("scan", 1, answer, ros::VoidConstPtr(), hints);
  ros::spin();
}
