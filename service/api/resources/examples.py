"""Examples for the description of the API."""

from __future__ import annotations

RIG_TOML = """[rig]
name = "compressor 3"
axes = ["xA", "xB", "yA", "yB"]

[rotor]
mass_kg = 280.0
transverse_inertia_kgm2 = 10.87
bearing_from_cog_m = [0.418, 0.404]
sensor_from_cog_m = [0.484, 0.470]

[bearings]
current_stiffness_n_per_a = 340.0
position_stiffness_n_per_m = 2.3e6
bias_current_a = 2.75
linear_range_m = 80e-6

[amplifier]
gain = 1.0
natural_frequency_hz = 1470.0
damping_ratio = 0.8

[sensor]
gain = 1.0

[controller]
sample_time_s = 1e-4
computing_delay_s = 0.0
numerator = [62000.0, -119000.0, 57200.0]
denominator = [1.0, -1.1, 0.1]

[limits]
displacement_m = 100e-6
current_a = 2.5
"""

RIG = "rig_01k9abcdefghjkmnpqrstvwxyz"
JOB = "job_01k9abcdefghjkmnpqrstvwxyz"
EXPERIMENT = "exp_01k9abcdefghjkmnpqrstvwxyz"
MODEL = "mod_01k9abcdefghjkmnpqrstvwxyz"
GAP = "gap_01k9abcdefghjkmnpqrstvwxyz"
HEALTH = "hc_01k9abcdefghjkmnpqrstvwxyz"
SCHEDULE = "sch_01k9abcdefghjkmnpqrstvwxyz"
TIME = "2026-03-01T12:00:00.000Z"
