"""The simulated rig as a device: state machine, lease, watchdog, limits, trips, and the servers of its buses."""
