"""What a case's effects are in the terms of the catalogue, where its law has the same figure."""

from __future__ import annotations

from typing import Any

import numpy as np

Values = dict[str, float]


def in_terms_of_the_catalogue(truth: dict[str, Any]) -> dict[str, Values]:
    """Parameters of the catalogue's effects, by effect; none where a law of another kind was drawn."""
    out = {}
    for effect, change in truth["changes"].items():
        values = _OF.get(effect, lambda c: {})(change)
        if values:
            out[effect] = {name: float(v) for name, v in values.items()}
    return out


def _amplifier(c: dict[str, Any]) -> Values:
    if "extra_pole_hz" in c:
        return {"lag_s": 1 / (2 * np.pi * c["extra_pole_hz"])}
    return {"frequency_change": c["relative"]} if "relative" in c else {}


def _controller(c: dict[str, Any]) -> Values:
    known = {"gain": "gain_change", "derivative": "derivative_change"}
    return {known[c["kind"]]: c["relative"]} if c["kind"] in known else {}


def _inertia(c: dict[str, Any]) -> Values:
    return {f"{of}_change": c["relative"] for of in ("mass", "inertia") if c["kind"] in (of, "both")}


def _modes(c: dict[str, Any]) -> Values:
    return {f"mode{k + 1}_log_ratio": np.log(c["factor"]) for k in c["modes"]}


_OF = {
    "loop_delay": lambda c: {"delay_s": c["delay"]},
    "logging_offset": lambda c: {"samples": c["_log_offset"]},
    "amplifier_bandwidth": _amplifier,
    "amplifier_voltage_limit": lambda c: {} if c["r_over_l_per_s"] else {"slew_inverse_s_per_a": 1 / c["slew_a_per_s"]},
    "channel_crosstalk": lambda c: {"share_ab": c["share"]} if c["kind"] == "b_in_a" else {},
    "controller_mismatch": _controller,
    "eddy_currents": lambda c: {"time_constant_s": c["eddy_tau"], "displacement_share": float(c["on_displacement"])},
    "magnetic_saturation": lambda c: (
        {"saturation_inverse_per_a": 1 / c["sat_A"]} if "sat_A" in c else {"flux_share": 1 / c["flux_ratio"]}
    ),
    "off_centre_rotor": lambda c: {
        f"offset_{axis}_m": x for axis, x in zip(("xA", "xB", "yA", "yB"), c["x0"], strict=True)
    },
    "magnetic_cross_coupling": lambda c: (  # which way a rotation is positive is each program's own
        {"symmetric_share": c["xy_mag"]} if c["kind"] == "symmetric" else {"rotation_rad": -c["xy_mag"]}
    ),
    "rotor_inertia": _inertia,
    "modal_damping": _modes,
    "support_resonance": lambda c: (  # of one that rocks, how far either end moves
        {} if c["house_each"] or c.get("house_rocks") else {"inverse_mass_per_kg": 1 / c["house_mass"]}
    ),
    "touchdown_contact": lambda c: {"stiffness_n_per_m": c["stiffness"]},
    "sensor_lag": lambda c: {"time_constant_s": 1 / (2 * np.pi * c["sensor_hz"])} if "sensor_hz" in c else {},
    "sensor_gain": lambda c: {f"gain_change_{('xA', 'xB', 'yA', 'yB')[c['axis']]}": c["relative"]},
    "sensor_position": lambda c: {"shift_A_m": c["shift"][0], "shift_B_m": c["shift"][1]},
    "internal_damping": lambda c: {"damping_ratio": c["damping_ratio"]} if len(c["modes"]) > 1 else {},
    "cross_coupled_stiffness": lambda c: (
        {} if c["by_speed"] or c["at"] != "both" else {"stiffness_n_per_m": c["k_n_per_m"]}
    ),
}
