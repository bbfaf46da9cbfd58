"""Sequences in the formats of other programs: TUM RGB-D folders, and MCAP files of ROS 2 messages."""
