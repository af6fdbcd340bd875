"""A datasheet is read without loss, and one that is wrong ends in one line that names the field."""

import re
import time
from dataclasses import fields, replace
from pathlib import Path

import pytest

from sim import datasheet, rig_file
from sim.datasheet import Tolerance
from sim.errors import AmbError, DatasheetError
from sim.reference import reference_datasheet, reference_rig
from sim.twin import rig_from_datasheet

TEXT = rig_file.to_toml(
    replace(
        reference_datasheet(),
        modes=(datasheet.Mode(492.9, 0.001, (0.08, -0.04), (0.08, 0.14)),),
        polar_inertia_kgm2=1.9,
        sensor_bandwidth_hz=(9e3,) * 4,
        tolerance=Tolerance(),
        tolerance_stated=True,
    )
)
PRACTICE = Path(__file__).resolve().parents[4] / "shared" / "practice"


def with_line(key: str, value: str, section: str = "") -> str:
    """The datasheet with ``key = value`` instead of what it says, in the section or where the key first occurs."""
    start = TEXT.index(section) if section else 0
    head, tail = TEXT[:start], TEXT[start:]
    lines = tail.splitlines()
    at = next(k for k, line in enumerate(lines) if line.startswith(f"{key} = "))
    lines[at] = f"{key} = {value}" if value else ""
    return head + "\n".join(lines)


NUMBERS = [
    "mass_kg",
    "transverse_inertia_kgm2",
    "polar_inertia_kgm2",
    "frequency_hz",
    "damping_ratio",
    "current_stiffness_n_per_a",
    "position_stiffness_n_per_m",
    "bias_current_a",
    "linear_range_m",
    "gain",
    "natural_frequency_hz",
    "bandwidth_hz",
    "sample_time_s",
    "computing_delay_s",
    "displacement_m",
    "current_a",
    "sensor_position_m",
]
REQUIRED = [
    "name",
    "axes",
    "mass_kg",
    "transverse_inertia_kgm2",
    "bearing_from_cog_m",
    "sensor_from_cog_m",
    "frequency_hz",
    "damping_ratio",
    "shape_at_bearings",
    "shape_at_sensors",
    "current_stiffness_n_per_a",
    "position_stiffness_n_per_m",
    "bias_current_a",
    "linear_range_m",
    "sample_time_s",
    "numerator",
    "denominator",
    "displacement_m",
    "current_a",
]


def refusal(text: str) -> str:
    with pytest.raises(DatasheetError) as caught:
        rig_file.parse(text, "my/rig.toml")
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith("my/rig.toml")
    return message


def test_what_is_written_is_read_back():
    once = rig_file.parse(TEXT)
    assert rig_file.parse(rig_file.to_toml(once)) == once
    assert once.tolerance_stated
    assert once.sensor_bandwidth_hz == (9e3,) * 4


def test_one_number_stands_for_all_axes():
    sheet = rig_file.parse(with_line("current_stiffness_n_per_a", "340"))
    assert sheet.current_stiffness_n_per_a == (340.0,) * 4


@pytest.mark.parametrize("key", REQUIRED)
def test_a_missing_value_is_named(key):
    assert key in refusal(with_line(key, ""))


@pytest.mark.parametrize("value", ["-1.0", "nan", "inf", "-inf", '"many"', "true", "{}"])
@pytest.mark.parametrize("key", NUMBERS)
def test_a_negative_a_non_finite_or_a_mistyped_value_is_named(key, value):
    assert key in refusal(with_line(key, value))


@pytest.mark.parametrize("key", [*NUMBERS, "numerator", "shape_at_sensors"])
def test_a_value_whose_square_no_arithmetic_holds_is_named(key):
    value = "1e200" if key in NUMBERS else "[1e200, 1.0]"
    assert "no rig has" in (told := refusal(with_line(key, value))) or "less than 1" in told
    assert key in told


@pytest.mark.parametrize("key", [k for k in NUMBERS if k not in ("damping_ratio", "computing_delay_s")])
def test_a_value_so_small_that_its_inverse_is_no_rigs_is_named(key):
    assert key in (told := refusal(with_line(key, "1e-200")))
    assert "no rig has a figure below" in told or "less than a thousandth" in told


@pytest.mark.parametrize("key", ["bearing_from_cog_m", "sensor_from_cog_m"])
@pytest.mark.parametrize("value", ["0.4", "[0.4]", "[0.4, 0.4, 0.4]", "[0.4, -0.4]", "[0.4, nan]", '[0.4, "x"]'])
def test_a_distance_is_a_pair_of_positive_numbers(key, value):
    assert key in refusal(with_line(key, value))


@pytest.mark.parametrize("value", ["[340.0, 340.0]", "[340.0, 340.0, 340.0, 340.0, 340.0]", "[]"])
def test_values_per_axis_are_one_or_one_per_axis(value):
    message = refusal(with_line("current_stiffness_n_per_a", value))
    assert "current_stiffness_n_per_a" in message
    assert "one for all or 4" in message


def test_zones_of_the_sensitivity_peak_are_the_standards_or_the_rigs_own():
    assert rig_file.parse(TEXT).sensitivity_zones_db == datasheet.ISO_14839_3_DB
    own = 'sensitivity_zones = ["fine", "bad"]\nsensitivity_zone_limits_db = [20]\n'
    sheet = rig_file.parse(TEXT.replace("[limits]\n", "[limits]\n" + own))
    assert sheet.sensitivity_zones_db == (("fine", 20.0), ("bad", float("inf")))
    assert rig_file.parse(rig_file.to_toml(sheet)) == sheet


@pytest.mark.parametrize(
    "own",
    [
        "sensitivity_zone_limits_db = [9.5]",
        "sensitivity_zone_limits_db = [9.5, 12.0, 12.0]",
        'sensitivity_zones = ["A", "A", "C", "D"]',
        "sensitivity_zone_limits_db = [9.5, 12.0, inf]",
    ],
)
def test_zones_need_names_of_their_own_and_rising_limits(own):
    assert "sensitivity_zone" in refusal(TEXT.replace("[limits]\n", f"[limits]\n{own}\n"))


@pytest.mark.parametrize("axes", ["[]", '["xA"]', '["xB", "xA"]', '["xA", "xB", "yA"]', '["zA", "zB"]', '"xA"'])
def test_axes_are_one_plane_or_two_in_order(axes):
    assert "axes" in refusal(with_line("axes", axes))


def test_an_amplifier_is_of_first_or_of_second_order_and_not_of_both():
    first = "[amplifier]\nbandwidth_hz = 1500\n"
    both = first + "natural_frequency_hz = 1500\ndamping_ratio = 0.8\n"
    half = "[amplifier]\nnatural_frequency_hz = 1500\n"
    head, tail = TEXT.split("[amplifier]", 1)
    tail = tail[tail.index("[sensor]") :]
    assert rig_file.parse(f"{head}{first}\n{tail}").amplifier_damping_ratio is None
    for wrong in (both, half, "[amplifier]\ngain = 1\n"):
        assert "either bandwidth_hz, or natural_frequency_hz with damping_ratio" in refusal(f"{head}{wrong}\n{tail}")


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("numerator", "[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]", "not causal"),
        ("denominator", "[0.0, 1.0, 1.0, 1.0, 1.0]", "first coefficient"),
        ("numerator", "[]", "numerator"),
        ("numerator", "[1.0, nan]", "numerator"),
    ],
)
def test_a_controller_that_cannot_run_is_refused(key, value, words):
    assert words in refusal(with_line(key, value))


def test_an_unknown_key_is_refused_so_that_a_slip_of_the_pen_is_seen():
    assert "mass" in refusal(TEXT.replace("mass_kg", "mass", 1))
    assert "colour" in refusal(TEXT + '\n[colour]\nname = "red"\n')


def test_text_that_is_no_toml_is_refused():
    assert "not valid TOML" in refusal("[rig\nname = ")


@pytest.mark.parametrize(
    ("text", "word"),
    [
        (f"a = {'[' * 3000}", "brackets"),
        (f"a = {'{a = ' * 3000}", "brackets"),
        (f"{'a.' * 20_000}a = 1", "20001 parts"),
        (f"[{'a . ' * 20_000}a]", "20001 parts"),
        ("'a'.\"b\"." * 2000 + "a = 1", "4001 parts"),
        (f'x = """a"""" # "\ny = {"[" * 3000}', "brackets"),
        ("a = 1" + "0" * 400, "a whole number"),
        ("a = 1" + "0" * 5000, "digits"),
        ("a" * 40_000, "not valid TOML"),
        ('"""\\' * 10_000, "not valid TOML"),
    ],
    ids=["lists", "tables", "key", "section", "quoted", "after text", "figure", "digits", "word", "text"],
)
def test_what_is_built_to_keep_a_reader_busy_is_refused_at_once(text, word):
    began = time.process_time()
    assert word in refusal(text)
    assert time.process_time() - began < 1


def test_dots_and_brackets_in_texts_and_comments_are_no_depth():
    name = "a.b.c.d.e.f.g.h.i.j [[[[[[[[[["
    assert rig_file.parse(f"# {name}\n" + with_line("name", f'"{name}"')).name == name
    assert rig_file.parse(with_line("name", f"'''{name}'s'''")).name == f"{name}'s"
    assert rig_file.parse(with_line("name", f'"""{name}\\""""')).name == f'{name}"'


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    with pytest.raises(DatasheetError, match=r"cannot read the datasheet .*absent\.toml"):
        rig_file.read(tmp_path / "absent.toml")
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(DatasheetError, match=r"binary\.toml"):
        rig_file.read(binary)
    with pytest.raises(AmbError):
        rig_file.read(tmp_path)


def test_numbers_that_toml_cannot_hold_are_not_written():
    with pytest.raises(DatasheetError, match="finite"):
        rig_file.to_toml(replace(reference_datasheet(), mass_kg=float("inf")))


def test_a_tolerance_that_is_not_stated_has_its_documented_default():
    head = TEXT[: TEXT.index("[tolerance]")]
    assert rig_file.parse(head).tolerance == Tolerance()
    assert not rig_file.parse(head).tolerance_stated
    partly = rig_file.parse(f"{head}[tolerance]\nmass = 0.1\n")
    assert partly.tolerance == replace(Tolerance(), mass=0.1)
    for f in fields(Tolerance):
        assert f.name in TEXT


def test_modes_are_sorted_by_frequency():
    late_first = TEXT.replace("[[modes]]", "[[modes]]\nfrequency_hz = 900.0\ndamping_ratio = 0.001\n"
                              "shape_at_bearings = [0.2, 0.1]\nshape_at_sensors = [0.2, 0.1]\n\n[[modes]]")  # fmt: skip
    assert [m.frequency_hz for m in rig_file.parse(late_first).modes] == [492.9, 900.0]


def test_the_rig_of_a_datasheet_has_its_values_stands_still_and_is_silent():
    sheet = rig_file.parse(TEXT)
    rig = rig_from_datasheet(sheet)
    assert rig.rotor.mass_kg == 280.0
    assert rig.magnets.ki.tolist() == [340.0] * 4
    assert rig.rotor.modes[1][0].shape_at_bearings == (0.08, -0.04)
    assert rig.speed_rad_s == 0.0
    assert rig.noise == replace(rig.noise, displacement_m=0.0, current_a=0.0)
    assert rig.displacement_limit_m == reference_rig().displacement_limit_m


def test_effects_that_a_diagnosis_has_added_are_in_the_rig():
    sheet = rig_file.parse(TEXT + "\n[effects.loop_delay]\ndelay_s = 2e-5\n")
    assert rig_from_datasheet(sheet).amplifiers.delay_s.tolist() == [2e-5] * 4
    assert rig_file.parse(rig_file.to_toml(sheet)) == sheet
    with pytest.raises(AmbError, match="no effect 'loop_lag'"):
        rig_from_datasheet(rig_file.parse(TEXT + "\n[effects.loop_lag]\ndelay_s = 2e-5\n"))


@pytest.mark.skipif(not PRACTICE.is_dir(), reason="no practice cases beside the repository")
def test_every_practice_case_has_a_datasheet_that_is_read():
    sheets = sorted(PRACTICE.glob("p*/rig.toml"))
    assert sheets
    for path in sheets:
        sheet = rig_file.read(path)
        assert sheet.n_axes == 4
        assert rig_file.parse(rig_file.to_toml(sheet)) == sheet


@pytest.mark.parametrize(
    ("key", "value", "told"),
    [
        ("displacement_m", "80", "limits.displacement_m: no rig has more than 0.01; give it in m, not in mm or um"),
        ("linear_range_m", "80.0", "bearings.linear_range_m: no rig has more than 0.01; give it in m"),
        ("bias_current_a", "2750", "bearings.bias_current_a: no rig has more than 1000; give it in A, not in mA"),
        ("computing_delay_s", "50", "controller.computing_delay_s: no rig has more than 0.1; give it in s"),
        ("bearing_from_cog_m", "[418, 404]", "rotor.bearing_from_cog_m.0: no rig has more than 5; give it in m"),
        (
            "position_stiffness_n_per_m",
            "[-2e6, 2e6, 2e6, 2e6]",
            "position_stiffness_n_per_m.0: Input should be greater",
        ),
    ],
)
def test_a_unit_that_no_rig_can_have_is_told_before_anything_moves(key, value, told):
    with pytest.raises(DatasheetError) as error:
        rig_file.parse(with_line(key, value))
    assert told in str(error.value)


@pytest.mark.parametrize(
    ("section", "lines", "told"),
    [
        ("amplifier", "bandwidth_hz = 1.5", r"amplifier\.bandwidth_hz is 1\.5, .* 10000 Hz .* Hz, not in kHz"),
        ("amplifier", "bandwidth_hz = [2000, 2000, 2, 2000]", r"amplifier\.bandwidth_hz is 2, "),
        ("amplifier", "natural_frequency_hz = 1.8\ndamping_ratio = 0.7", r"amplifier\.natural_frequency_hz is 1\.8, "),
        ("sensor", "bandwidth_hz = 9", r"sensor\.bandwidth_hz is 9, "),
    ],
)
def test_a_bandwidth_in_kilohertz_is_told(section: str, lines: str, told: str) -> None:
    other = re.sub(rf"(?ms)^\[{section}\]\n.*?(?=^\[)", f"[{section}]\n{lines}\n\n", TEXT)
    assert lines in other
    with pytest.raises(DatasheetError, match=told):
        rig_file.parse(other)


def test_a_slow_amplifier_in_hertz_is_one() -> None:
    slow = re.sub(r"(?ms)^\[amplifier\]\n.*?(?=^\[)", "[amplifier]\nbandwidth_hz = 40\n\n", TEXT)
    assert rig_file.parse(slow).amplifier_natural_frequency_hz == (40.0,) * 4


def test_of_a_name_that_is_wrong_the_name_is_told_and_not_what_is_missing_for_it():
    told = refusal(TEXT.replace("mass_kg = ", "mass = "))
    assert told == "my/rig.toml: rotor.mass is not known, is rotor.mass_kg meant?"
    assert refusal(TEXT.replace("[limits]", "[limit]")) == "my/rig.toml: [limit] is not known, is [limits] meant?"
    told = refusal(TEXT.replace("damping_ratio = 0.001", "damping = 0.001"))
    assert told == "my/rig.toml: modes.0.damping is not known, is modes.0.damping_ratio meant?"
    assert refusal(TEXT + "\n[stator]\n") == "my/rig.toml: [stator] is not known"


def test_of_many_problems_the_first_are_told_and_the_others_counted():
    told = "my/rig.toml: [rig] is missing; [rotor] is missing; [bearings] is missing; and 3 more"
    assert refusal("") == told
    wrong = with_line("mass_kg", "-280").replace("bias_current_a = ", "bias_curent_a = ")
    told = refusal(wrong)
    assert told.startswith("my/rig.toml: bearings.bias_curent_a is not known, is bearings.bias_current_a meant?; ")
    assert told.endswith("rotor.mass_kg: Input should be greater than 0 (it is -280.0)")


@pytest.mark.parametrize(
    ("section", "said"),
    [
        ("[effects.loop_delayy]\ndelay_s = 1e-5", "no effect 'loop_delayy' in the catalogue; known are .*loop_delay"),
        ("[effects.loop_delay]\ndelay = 1e-5", "effect loop_delay has no parameter 'delay'; it has delay_s"),
        ("[effects.loop_delay]\ndelay_s = 0.5", "loop_delay.delay_s = 0.5 s is outside"),
    ],
)
def test_an_effect_that_cannot_be_is_refused_where_the_file_is_read(section: str, said: str) -> None:
    """And not once the experiment is measured."""
    with pytest.raises(DatasheetError, match=f"bench.toml: {said}"):
        rig_file.parse(f"{TEXT}\n{section}\n", "bench.toml")


def test_a_byte_order_mark_as_some_editors_write_it_is_no_matter(tmp_path: Path) -> None:
    sheet = reference_datasheet()
    (tmp_path / "rig.toml").write_text(rig_file.to_toml(sheet), encoding="utf-8-sig")
    assert rig_file.read(tmp_path / "rig.toml") == sheet
