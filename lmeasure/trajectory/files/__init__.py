"""Files of trajectories: ours, foreign tables, ROS 2 messages."""
