//! A simulated racecar: world, lidar, vehicle.
