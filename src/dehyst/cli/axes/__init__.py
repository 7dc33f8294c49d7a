"""What commands do with several axes: records and paths of a stage, its rig, and its C."""
