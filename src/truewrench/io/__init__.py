"""Readers and writers: tables, plans, recordings (rosbag2, MCAP, ROS 1), and the formats of others."""
