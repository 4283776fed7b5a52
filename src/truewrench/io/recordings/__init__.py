"""Recordings of ROS as tables: rosbag2, MCAP and ROS 1 bags (docs/formats.md)."""
