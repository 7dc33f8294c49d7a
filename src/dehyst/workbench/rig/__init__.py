"""The process that holds a rig, with its watchdog and its emergency stop, and the server's link to it."""
