"""The simulated rig in process: the device of `drivers.device` without a bus."""
