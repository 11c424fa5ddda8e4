"""Motion of the gripper: velocity, rests, vibration, attained poses."""
