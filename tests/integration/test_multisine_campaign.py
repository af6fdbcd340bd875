"""A rig commissioned by multisines: as exact as it says, in a tenth of the time, and as safe as tone by tone."""

import json
import threading
from dataclasses import replace

import numpy as np
import pytest

from drivers.controller import TripCause, Waveform
from drivers.errors import CancelledError, LeaseError, LimitError, TripError
from drivers.simulated.driver import SimulatedController
from service.campaign.multisine.plan import MultisineProfile
from service.campaign.run import recover, run_campaign
from service.experiment.errors import CampaignError
from service.experiment.file import read
from service.experiment.multisine import synthesise
from service.experiment.speeds import changed_speed
from service.identification.fit import identify
from sim.reference import reference_datasheet, reference_rig
from sim.twin import linear_model
from tests.support.campaigns import Faulty, assert_same
from tests.support.synthetic import known_datasheet, true_rig
from tests.support.two_axes import sheet_of_one_plane

pytestmark = pytest.mark.slow

RIG, SHEET = reference_rig(), reference_datasheet()
PLANE = sheet_of_one_plane(known_datasheet()[1])
PLANE_RIG = replace(true_rig(PLANE), noise=RIG.noise)
"""Two axes, for what does not ask for four: pilot and phases are calculated in a third of the time."""
SHORT = MultisineProfile(
    lines=100, periods=2, realisations=2, validation_realisations=2, amplifier_realisations=2, amplifier_lines=24
)  # fmt: skip


class Counted(Faulty):
    """Faults before the n-th waveform."""

    def __init__(self, fault):
        super().__init__(fault, PLANE_RIG)

    def measure_periodic(self, waveform):
        self.n += 1
        self.fault(self.n)
        return self.inner.measure_periodic(waveform)


def campaign(folder, rig=None, profile=SHORT, **options):
    controller = rig if rig is not None else SimulatedController(PLANE_RIG, seed=1)
    return run_campaign(controller, PLANE, folder, profile=profile, **options)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("multisine")
    return folder, run_campaign(SimulatedController(RIG, seed=1), SHEET, folder, profile=MultisineProfile())


@pytest.fixture(scope="module")
def identified(whole):
    """What the file of the whole campaign tells."""
    return identify(read(whole[0] / "experiment.h5"), SHEET)


@pytest.fixture(scope="module")
def counted(tmp_path_factory):
    """A short campaign, and how often it played something."""
    rig = Counted(lambda k: None)
    return campaign(tmp_path_factory.mktemp("short"), rig), rig.n


@pytest.fixture(scope="module")
def short(counted):
    return counted[0]


def test_ki_ks_and_modes_are_within_three_reported_deviations_of_the_truth(identified):
    result = identified.document("experiment.h5")
    for p, (name, plane) in enumerate(result["planes"].items()):
        for b, bearing in enumerate("AB"):
            for key, truth in (("ki", RIG.magnets.ki), ("ks", RIG.magnets.ks)):
                found = plane["stiffness"][key + bearing]
                error = found["value"] - truth[2 * p + b]
                assert abs(error) < 3 * found["std"], (name, key, bearing)
                assert found["std"] < 4e-4 * truth[2 * p + b]
        assert len(plane["rotor_modes"]) == 2
        for mode, truth in zip(plane["rotor_modes"], RIG.rotor.modes[p], strict=True):
            wn, zeta = mode["natural_frequency_rad_s"], mode["damping_ratio"]
            assert abs(wn["value"] - truth.natural_frequency_rad_s) < 3 * wn["std"]
            assert abs(zeta["value"] - truth.damping_ratio) < 3 * zeta["std"]
            assert zeta["std"] < 0.02 * truth.damping_ratio


def test_it_takes_a_tenth_of_the_stepped_sines_rig_time_and_says_so(whole):
    """The stepped sine takes 1168 s on this rig (benchmarks/multisine.py)."""
    seconds = float(whole[1].attributes["rig_seconds"])
    assert 60 < seconds < 130
    assert whole[1].main.time_s.max() < seconds


def test_damping_ratios_are_told_as_exactly_as_ki_and_ks_are_by_a_thousand_seconds_of_tones(whole, identified):
    """The pilot knows the peaks; the stepped sine leaves 0.03 to 0.08 % on this rig (benchmarks/multisine.py)."""
    assert "not_designed" not in whole[1].attributes
    for plane in identified.planes.values():
        assert all(m.damping_ratio.std_from_data < 6e-4 * m.damping_ratio.value for m in plane.modes)


def test_a_rig_whose_pilot_no_model_explains_is_measured_all_the_same(tmp_path, short):
    other = replace(PLANE, numerator=tuple(1.4 * c for c in PLANE.numerator))
    found = run_campaign(SimulatedController(PLANE_RIG, seed=1), other, tmp_path, profile=SHORT)
    assert "of the pilot" in found.attributes["not_designed"]
    assert [s.comment for s in found.sweeps] == [s.comment for s in short.sweeps]
    assert found.main.n_points < short.main.n_points  # without the peaks' own lines


def test_the_file_has_all_sweeps_in_the_contracts_form(whole):
    folder, experiment = whole
    assert [s.comment for s in experiment.sweeps] == ["main", "validation", "amplifier", "noise"]
    assert [s.kind for s in experiment.sweeps] == ["multisine"] * 3 + ["noise"]
    assert {p.name for p in folder.iterdir()} == {"experiment.h5"}
    stored = read(folder / "experiment.h5")
    assert_same(stored, experiment)
    np.testing.assert_array_equal(stored.main.phase_rad, experiment.main.phase_rad)
    main = stored.main
    own = main.R[np.arange(main.n_points), :, 0, main.axis]
    assert np.all(own.real > 0)
    assert np.max(np.abs(own.imag)) < 1e-6 * np.max(own.real)
    others = np.abs(main.R).sum(axis=3)[:, :, 0] - np.abs(own)
    assert np.max(others) < 1e-4 * np.min(np.abs(own))  # the inputs were separated


def test_displacements_stay_within_their_share(whole):
    """The peaks of all lines together, every axis, as the phases make them."""
    profile = MultisineProfile()
    main = whole[1].main
    allowed = profile.displacement_share * min(SHEET.displacement_limit_m, SHEET.linear_range_m)
    line = np.round(main.frequency_hz).astype(int)
    for b in range(profile.realisations):
        columns = (main.Y[:, b, 0] * np.exp(1j * main.phase_rad[:, b])[:, None]).reshape(-1, 4, 4)
        y = synthesise(columns.sum(axis=1), line[::4], 4096)  # experiment 0: all signs positive
        assert np.max(np.abs(y)) < 1.1 * allowed


def test_the_plant_is_measured(short):
    main = short.main
    f = np.unique(main.frequency_hz)
    U, Y = (x[:, :, 0].mean(axis=1).reshape(len(f), 2, 2).swapaxes(1, 2) for x in (main.U, main.Y))
    truth = linear_model(PLANE_RIG, f).y_per_u
    error = np.linalg.norm(Y @ np.linalg.inv(U) - truth, axis=(1, 2)) / np.linalg.norm(truth, axis=(1, 2))
    assert np.median(error) < 0.01


def test_distortion_is_told_apart_from_noise(whole):
    levels = json.loads(whole[1].attributes["distortion_db"])["main"]["y"]
    # the magnets' law is odd round the centre; the displacement's cubic terms stand out of the noise
    assert all(x is not None and -80 < x < -50 for x in levels["odd"])
    assert all(x is None or x < -75 for x in levels["even"])
    assert all(-80 < x < -50 for x in levels["noise"])


class RunsDown(Counted):
    """A rotor that turns a little slower with every waveform."""

    def status(self):
        return replace(self.inner.status(), speed_rad_s=100.0 - self.n)


def test_a_multisine_has_the_speed_furthest_from_the_campaigns_of_all_that_it_is_made_of(tmp_path):
    """Its points are of several waveforms, and of one realisation after the other."""
    experiment = campaign(tmp_path, RunsDown(lambda k: None))
    main = experiment.main
    (speed,) = set(main.point_speed_rad_s.tolist())
    assert 50.0 < speed < 98.0
    (told,) = changed_speed(experiment)
    assert f"at {main.n_points} of {main.n_points} points of main (" in told
    assert f"{speed:.4g} rad/s in place of 100" in told


def test_equal_campaigns_are_equal(tmp_path, short):
    assert_same(campaign(tmp_path), short)


# ---- safety


@pytest.mark.parametrize("n", [3, 9])
def test_an_interrupt_stops_the_rig_and_the_campaign_goes_on_where_it_stopped(tmp_path, counted, n):
    short, played = counted

    def fault(k):
        if k == n:
            raise KeyboardInterrupt

    rig = Counted(fault)
    with pytest.raises(CancelledError, match="run it again"):
        campaign(tmp_path, rig)
    assert rig.stops
    assert rig.status().excitation_a == 0
    assert rig.status().lease_holder == ""
    kept = recover(tmp_path)
    assert kept.named("noise") is not None
    assert "not_designed" not in kept.attributes  # the journal tells the datasheet that the pilot is fitted with
    resumed = Counted(lambda k: None)
    whole = campaign(tmp_path, resumed)
    assert [s.comment for s in whole.sweeps] == [s.comment for s in short.sweeps]
    assert resumed.n == played - (n - 1)
    assert float(whole.attributes["rig_seconds"]) == pytest.approx(float(short.attributes["rig_seconds"]), rel=0.2)


def test_a_cancel_ends_a_waveform_that_is_being_played(tmp_path):
    flag = threading.Event()

    def progress(report):
        if report.phase == "main":
            flag.set()

    rig = SimulatedController(PLANE_RIG, seed=1)
    with pytest.raises(CancelledError):
        campaign(tmp_path, rig, progress=progress, cancelled=flag.is_set)
    assert rig.status().excitation_a == 0


def test_a_rig_that_trips_is_measured_at_a_lower_level(tmp_path, short):
    tight = replace(PLANE_RIG, displacement_limit_m=9e-6)
    experiment = campaign(tmp_path, SimulatedController(tight, seed=1))
    # lines on the peaks, which move no rotor, may be as large as ever
    tight_m, usual_m = (np.linalg.norm(e.main.Y[:, :, 0]) for e in (experiment, short))
    assert tight_m < 0.3 * usual_m
    assert experiment.main.n_points == short.main.n_points


def test_a_sweep_that_trips_is_played_on_at_half_its_level(tmp_path, short):
    """The pilot moves the rotor too little to trip it; what is designed from that may be too much."""

    class Weak(Counted):
        pilot_a = most_a = np.inf
        tripped = 0

        def measure_periodic(self, waveform):
            if self.most_a == np.inf and waveform.peak_a > 1.5 * self.pilot_a:  # the first one after the pilot
                self.most_a = 0.9 * waveform.peak_a
            if waveform.peak_a > self.most_a:
                self.tripped += 1
                raise TripError("displacement", "displacement of axis xA reached its limit")
            self.pilot_a = min(self.pilot_a, waveform.peak_a or np.inf)
            return self.inner.measure_periodic(waveform)

    rig = Weak(lambda k: None)
    experiment = campaign(tmp_path, rig)
    assert 1 <= rig.tripped <= 3  # once a sweep: what follows within it begins lower
    assert set(experiment.main.flags) == {"repeated at lower amplitude after a displacement trip"}
    ratio = np.linalg.norm(experiment.main.R) / np.linalg.norm(short.main.R)
    assert ratio == pytest.approx(0.5, rel=0.02)
    assert experiment.main.n_points == short.main.n_points


def test_a_pilot_that_trips_is_repeated_at_a_quarter_of_its_level(tmp_path):
    peaks = []

    class Touchy(Counted):
        def measure_periodic(self, waveform):
            if waveform.peak_a:
                peaks.append(waveform.peak_a)
                if len(peaks) == 1:
                    raise TripError("displacement", "displacement of axis xA reached its limit")
                raise KeyboardInterrupt  # the rest is another test's
            return self.inner.measure_periodic(waveform)

    with pytest.raises(CancelledError):
        campaign(tmp_path, Touchy(lambda k: None))
    assert peaks[1] == pytest.approx(peaks[0] / 4, rel=0.01)


def test_a_rig_that_trips_at_every_level_is_given_up_with_the_excitation_off(tmp_path):
    class Tripping(Counted):
        def measure_periodic(self, waveform):
            if waveform.peak_a:
                raise TripError("displacement", "displacement of axis xA reached its limit")
            return self.inner.measure_periodic(waveform)

    rig = Tripping(lambda k: None)
    with pytest.raises(CampaignError, match="trips even with"):
        campaign(tmp_path, rig)
    assert rig.stops
    assert rig.status().excitation_a == 0


def test_a_controller_without_waveforms_is_refused_before_anything_moves(tmp_path):
    class TonesOnly(Faulty):
        def capabilities(self):
            return replace(self.inner.capabilities(), periodic=False)

    rig = TonesOnly(lambda k: None, PLANE_RIG)
    with pytest.raises(CampaignError, match="stepped sine"):
        campaign(tmp_path, rig)
    assert rig.status().uptime_s >= 0
    assert rig.n == 0


# ---- the verb


WAVE = Waveform(0.02 * np.cos(2 * np.pi * np.arange(500) / 500)[:, None] * np.array([1.0, -1.0, 0.5, 0.0]), 3, 500)


def test_a_waveform_is_recorded_as_it_is_played():
    rig = SimulatedController(RIG, seed=1)
    with rig.lease("test"):
        found = rig.measure_periodic(WAVE)
    assert found.records["y"].shape == (1500, 4)
    np.testing.assert_allclose(found.records["r"], np.tile(WAVE.r_a, (3, 1)), atol=0.5e-6)
    assert 0 < np.abs(found.records["y"]).max() <= found.peak_displacement_m * (1 + 1e-6)
    assert found.rig_seconds == pytest.approx(0.2 + 0.2, abs=1e-3)  # both ramps, settling and record
    assert rig.status().excitation_a == 0


def test_a_waveform_needs_the_lease_and_keeps_the_limits():
    rig = SimulatedController(RIG, seed=1)
    with pytest.raises(LeaseError):
        rig.measure_periodic(WAVE)
    with rig.lease("test"):
        for wrong in (
            replace(WAVE, r_a=WAVE.r_a * 1000),
            replace(WAVE, r_a=WAVE.r_a[:, :2]),
            replace(WAVE, r_a=WAVE.r_a * np.nan),
            replace(WAVE, periods=0),
            replace(WAVE, settle_samples=10**8),
        ):
            with pytest.raises(LimitError):
                rig.measure_periodic(wrong)


def test_a_waveform_that_moves_the_rotor_too_far_trips_with_the_excitation_off():
    rig = SimulatedController(replace(RIG, displacement_limit_m=1e-6), seed=1)
    with rig.lease("test"):
        with pytest.raises(TripError):
            rig.measure_periodic(WAVE)
        status = rig.status()
        assert status.trip is TripCause.DISPLACEMENT
        assert status.excitation_a == 0
        rig.acknowledge()


def test_leaving_the_lease_ends_a_waveform():
    rig = SimulatedController(RIG, seed=1)
    long = replace(WAVE, settle_samples=1_500_000)
    caught = []

    def play():
        try:
            with rig.lease("test"):
                rig.measure_periodic(long)
        except CancelledError as error:
            caught.append(error)

    thread = threading.Thread(target=play)
    thread.start()
    while rig.status().excitation_a == 0:
        pass
    rig.stop()
    thread.join(20)
    assert caught
    assert rig.status().excitation_a == 0


class Coarse(Faulty):
    """A rig that logs its displacement in steps of 2 um."""

    def measure_periodic(self, waveform):
        found = self.inner.measure_periodic(waveform)
        y = 2e-6 * np.round(found.records["y"] / 2e-6)
        return replace(found, records={**found.records, "y": y})


def test_an_experiment_whose_log_is_coarser_than_the_motion_can_be_read(tmp_path):
    campaign(tmp_path, Coarse(lambda k: None, PLANE_RIG), replace(SHORT, lines=40, amplifier_lines=12))
    amplifier = next(s for s in read(tmp_path / "experiment.h5").sweeps if s.comment == "amplifier")
    assert np.all(amplifier.kurtosis == 1.0)
