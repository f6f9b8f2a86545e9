"""Fits of damped modes to data whose noise is not white, or not constant."""

import control as ct
import numpy as np
import pytest
from known import HELD
from noisy_plants import DELAY, SHARE, SIZES, plant, recording, response
from scipy.signal import lfilter
from slow import slowly

import ph_control as phc


def causes(result):
    return {one.cause.name: one for one in result.findings}


# --- frequency responses ---------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(("outputs", "inputs"), [(1, 1), *slowly((2, 1))])
def test_noise_that_grows_with_the_gain_adds_no_modes_and_its_intervals_hold(outputs, inputs):
    poles, _ = plant(3, outputs, inputs, 0)
    result = phc.pem(response(3, outputs, inputs, "gain", 0), structure="free")
    assert result.order == 3
    intervals, covered = result.confidence_interval(), []
    for name, true in (("natural_frequencies", np.abs(poles)), ("damping_ratios", -poles.real / np.abs(poles))):
        low, high = intervals[name].T
        covered += ((low <= true) & (true <= high)).tolist()
    assert np.mean(covered) > 0.8


@pytest.mark.slow
def test_the_share_of_the_gain_is_found_for_each_response_and_each_point_has_its_weight():
    result = phc.pem(response(3, 2, 1, "both", 0))
    finding = causes(result)["GAIN_NOISE"]
    assert finding.gain > 50
    np.testing.assert_allclose(finding.values, SHARE, rtol=0.25)
    assert "grows with the gain" in result.message
    weights, gain = result.record.weights, np.abs(result.predicted)
    assert np.all(weights[gain == gain.max(axis=-1, keepdims=True)] < 0.1 * weights.max(axis=(1, 2)))
    np.testing.assert_allclose(result.noise_variance, 1.0, rtol=0.2)


@pytest.mark.slow
def test_constant_noise_keeps_equal_weights_and_given_ones_stay():
    data = response(3, 2, 1, "constant", 1)
    assert "GAIN_NOISE" not in causes(phc.pem(data)) and np.ptp(phc.pem(data).record.weights) == 0
    data = response(3, 2, 1, "gain", 1)
    given = phc.pem(data, 3, weights=np.ones(data.frdata.shape))
    assert "GAIN_NOISE" not in causes(given) and np.ptp(given.record.weights) == 0
    own = phc.pem(data, 3)
    true = np.abs(plant(3, 2, 1, 1)[0])
    assert np.abs(own.d - true).max() < np.abs(given.d - true).max()


# --- recordings ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_intervals_cover_and_classical_damping_stands_beside_forces_that_were_not_measured():
    covered, rejected = [], []
    for seed in range(4):
        result = phc.pem(recording(2, 1, 1, "forces", seed, 1500), 2, dt=1.0, structure="auto", ports=[(0, 0)])
        d = np.abs(plant(2, 1, 1, seed)[0])
        low, high = result.confidence_interval()["natural_frequencies"].T
        covered += ((low <= d) & (d <= high)).tolist()
        rejected += [one.p < 0.05 for one in result.tests if one.hypothesis == "classical"]
    assert np.mean(covered) > 0.75 and sum(rejected) <= 1


@pytest.mark.slow
def test_hits_keep_their_shapes_where_the_recorded_force_is_noisy():
    tower = phc.spring_chain([1.0, 1.0, 1.0], 4e3, ground=[4e3, 0, 0], c=0.4, port=(0, 1, 2))
    rng, fine, hits = np.random.default_rng(3), np.arange(9600) / 3200.0, []
    force = np.where((fine >= 0.1) & (fine < 0.12), 100 * np.sin(np.pi * (fine - 0.1) / 0.02), 0.0)
    for place in np.eye(3):
        motion = phc.forced_response(tower, fine, np.outer(place, force), intersample="foh").outputs[2, ::16]
        noise = rng.standard_normal((2, len(motion)))
        hits.append((np.outer(place, force[::16] + noise[0]), motion + 0.002 * motion.std() * noise[1]))
    result = phc.pem(hits, 3, dt=0.005, ports=[(0, 2)], intersample="foh", real_poles=0, delay=0.0)
    assert "INPUT_NOISE" in causes(result)
    found, true = result.participation, phc.modes(tower).participation
    alike = np.abs(np.sum(found.conj() * true, axis=1)) ** 2
    assert np.all(alike > 0.95 * np.sum(np.abs(found) ** 2, axis=1) * np.sum(np.abs(true) ** 2, axis=1))


@pytest.mark.variants
@pytest.mark.parametrize("noise", ["input", "forces"])
def test_noise_that_comes_through_the_modes_is_told_with_its_size(noise):
    result = phc.pem(recording(2, 1, 1, noise, 0, 3000), 2, dt=1.0, structure="free", **HELD)
    finding = causes(result)["FORCES"]
    np.testing.assert_allclose(finding.values, [0.1], rtol=0.25)
    assert finding.gain > 100 and "move the plant" in result.message and result.outcome.name == "CONSISTENT"


@pytest.mark.slow
def test_coloured_residuals_are_told_with_their_band_for_the_outputs_that_have_them(tmp_path):
    u, y = recording(2, 2, 1, "white", 4, 1500)
    y[1] = recording(2, 2, 1, "coloured", 4, 1500)[1][1]
    result = phc.pem((u, y), 2, dt=0.5, structure="free")
    finding = causes(result)["COLOURED_RESIDUALS"]
    assert finding.output == "y2" and sum(one.output != "" for one in result.findings) == 1
    low, high, size, share = finding.values
    # of e_k = 0.9 e_(k-1) + white
    edge = np.arccos(1 - 0.1**2 / (2 * 0.9)) / 0.5
    assert low == 0
    np.testing.assert_allclose([high, size, share], [edge, 100, 0.5], rtol=0.4)
    np.testing.assert_allclose(result.experiments[0].residuals[1].std(), np.sqrt(result.noise_variance[1]), rtol=0.02)
    phc.save(result, tmp_path / "fit.json")
    assert phc.load(tmp_path / "fit.json").findings == result.findings
    assert f"between 0 and {high:.4g} rad per unit time" in result.message
    data = ct.TimeResponseData(0.5 * np.arange(u.shape[-1]), y, inputs=u)
    data.time_unit = "ms"
    assert f"between 0 and {1e3 * high / (2 * np.pi):.4g} Hz" in phc.pem(data, 2, structure="free").message


@pytest.mark.parametrize("seed", [1, 43])
def test_residuals_of_a_lag_that_is_missing_are_whitened_only_where_that_is_likelier(seed):
    rng = np.random.default_rng(seed)
    u, y = lfilter([1], [1, -0.9], rng.standard_normal(450)), np.zeros((2, 450))
    for rate in (0.48, 0.32):
        z = np.exp(-0.1 * rate)
        y += rng.standard_normal((2, 1)) * lfilter([0, 1 - z], [1, -z], u)
    pole = 0.64 * (-0.0048 + 1j)
    z = np.exp(0.1 * pole)
    y += rng.standard_normal((2, 1)) * 2 * lfilter([0, 1], [1, -z], (z - 1) / pole * 0.32 * u.astype(complex)).real
    u, y = u[300:], y[:, 300:]
    y = y + 0.0015 * y.std(axis=1, keepdims=True) * rng.standard_normal(y.shape)
    result, white = (
        phc.pem((u, y), 1, dt=0.1, real_poles=1, intersample="zoh", delay=0.0, noise=noise)
        for noise in ("auto", "white")
    )
    assert result.bic < white.bic + 8


def test_white_residuals_are_told_as_nothing():
    for seed in range(2):
        result = phc.pem(recording(2, 2, 1, "white", seed), 2, dt=1.0, structure="free")
        assert not {"COLOURED_RESIDUALS", "INPUT_NOISE", "OUTLIERS"} & causes(result).keys()


@pytest.mark.variants
@pytest.mark.parametrize(("outputs", "inputs"), SIZES)
def test_a_value_far_out_of_the_noise_is_told_with_its_output(outputs, inputs):
    result = phc.pem(recording(2, outputs, inputs, "outlier", 1), 2, dt=1.0, structure="free", **HELD)
    finding = causes(result)["OUTLIERS"]
    assert (finding.values, finding.output) == ((333,), result.output_labels[0])
    assert "mark them with NaN" in result.message and result.outcome.name == "DOUBTFUL"
    assert result.message.startswith("Doubtful, as some values") and "explains the data" not in result.message


def test_two_per_cent_of_wild_samples_are_named_in_a_short_record():
    rng, z = np.random.default_rng(1), np.exp(-1 / 12)
    u = np.repeat(rng.choice([0.0, 10.0], 13), 20)[:250]
    y = 60 + lfilter([0.0, 1.5 * (1 - z)], [1.0, -z], u) + 0.1 * rng.standard_normal(250)
    wild = np.sort(rng.choice(250, 5, replace=False))
    y[wild] += 3.0
    result = phc.pem((u, y), dt=1.0, quantity="free")
    assert causes(result)["OUTLIERS"].values == tuple(wild)
    assert abs(result.time_constants[0] - 12) < 3 * result.stderr["time_constants"][0]


def test_an_output_that_saturates_is_told_with_the_ends_of_its_range():
    u, y = recording(2, 2, 1, "white", 1)
    end = 0.6 * np.abs(y[1]).max()
    clipped = np.array([y[0], np.clip(y[1], -end, end)])
    result = phc.pem((u, clipped), 2, dt=1.0, structure="free", **HELD)
    finding = causes(result)["SATURATION"]
    assert finding.values == (np.count_nonzero(np.abs(y[1]) >= end), -end, end)
    assert finding.output == result.output_labels[1] and "saturates" in result.message
    coarse = np.round(y * 20 / np.abs(y).max())
    assert "SATURATION" not in causes(phc.pem((u, coarse), 2, dt=1.0, structure="free", **HELD))


@pytest.mark.slow
def test_ambient_excitation_is_told_from_a_free_decay():
    _, y = recording(2, 2, 1, "white", 1)
    ambient = phc.pem((None, y), 2, dt=1.0)
    assert ambient.is_ambient and "Forces that nobody measured" in ambient.message
    assert ambient.outcome.name == "CONSISTENT"
    y[0, 7] = np.nan
    assert phc.pem((None, y), 2, dt=1.0).is_ambient
    # with many samples missing it is taken as a decay, and the doubt is told
    y[0, ::5] = np.nan
    doubtful = phc.pem((None, y), 2, dt=1.0)
    assert "such as wind or traffic" in doubtful.message and doubtful.outcome.name == "DOUBTFUL"
    t, noise = np.arange(600), 0.01 * np.random.default_rng(0).standard_normal((2, 600))
    decay = [[1.0], [0.7]] * np.exp(-0.01 * t) * np.cos(0.5 * t) + noise
    assert "AMBIENT" not in causes(phc.pem((None, decay), 1, dt=1.0))


def test_a_point_far_out_of_the_noise_is_told_with_its_entry():
    data = response(2, 2, 1, "constant", 1)
    values = data.frdata.copy()
    values[1, 0, 300] += 1j * np.sqrt(np.mean(np.abs(values[1, 0]) ** 2))  # 20 standard deviations, between peaks
    result = phc.pem(ct.frd(values, data.omega), 2)
    finding = causes(result)["OUTLIERS"]
    assert (finding.values, finding.output) == ((300,), f"{result.output_labels[1]}:{result.input_labels[0]}")


# --- the error over what is held out ---------------------------------------------------------------------------------


@pytest.mark.variants
@pytest.mark.parametrize(("outputs", "inputs"), [(1, 1), (2, 1)])
def test_the_order_is_that_of_the_least_error_over_what_is_held_out(outputs, inputs):
    assert phc.pem(response(3, outputs, inputs, "constant", 0), criterion="holdout", structure="free").order == 3
    u, y = recording(3, outputs, inputs, "white", 0, 600)
    assert phc.pem((u, y), dt=1.0, criterion="holdout", structure="free", **HELD).order == 3
    y[0, 450:] = np.nan
    assert phc.pem((u, y), dt=1.0, criterion="holdout", structure="free", **HELD).order == 3


def test_a_part_of_which_nothing_was_measured_cannot_be_foretold():
    u, y = recording(3, 2, 1, "white", 0, 600)
    y[:, 390:] = np.nan
    with pytest.raises(phc.IdentificationError, match="to predict"):
        phc.pem((u, y), dt=1.0, criterion="holdout")


# --- responses with little in them -----------------------------------------------------------------------------------


def test_few_lines_show_no_mode_and_fewer_are_refused():
    data = response(3, 3, 2, "constant", 0)
    few = phc.pem(ct.frd(data.frdata[:, :, :8], data.omega[:8]))
    assert few.order == 0 and few.outcome.name == "NOTHING" and np.isnan(few.covariance).all()
    with pytest.raises(phc.IdentificationError, match=r"1 mode has 14 unknowns .* 12 observed samples .* at least 20"):
        phc.pem(ct.frd(data.frdata[:, :, :1], data.omega[:1]))


@pytest.mark.variants
@pytest.mark.parametrize(
    "kind", ["an entry of zeros", "an input of zeros", "a line at 0", *slowly("an entry of five lines")]
)
def test_an_entry_that_shows_nothing_does_not_hide_the_modes(kind):
    data = response(3, 3, 2, "constant", 0)
    G, omega = data.frdata.copy(), data.omega.copy()
    if kind == "an entry of zeros":
        G[1, 1] = 0
    elif kind == "an input of zeros":
        G[:, 1] = 0
    elif kind == "an entry of five lines":
        G, omega = G[..., ::3], omega[::3]
        G[1, 1, 5:] = np.nan
    else:
        G[:, :, 0], omega[0] = 0, 0
    result = phc.pem(ct.frd(G, omega))
    assert result.order == 3
    np.testing.assert_allclose(result.d, np.abs(plant(3, 3, 2, 0)[0]), rtol=1e-3)


# --- delays and drifts -----------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "outputs", "inputs"), [("delay", 1, 1), *slowly(("drift", 3, 2))])
def test_delays_and_drifts_are_named_and_add_no_modes(kind, outputs, inputs):
    u, y = recording(3, outputs, inputs, kind, 0)
    result = phc.pem((u, y), dt=1.0, structure="classical", ports=[(0, 0)])
    poles, residues = plant(3, outputs, inputs, 0)
    assert result.order == 3
    finding = causes(result)[kind.upper()]
    assert finding.gain > 10 and "(log-likelihood + " in result.message
    if kind == "delay":
        found, error = finding.values
        assert abs(found - DELAY) < 4 * error < 0.1
        assert result.experiments[0].record.samples == u.shape[1]
    else:
        slopes = 3 * np.std(recording(3, outputs, inputs, "white", 0)[1], axis=1) / u.shape[1]
        np.testing.assert_allclose(finding.values, slopes, rtol=0.05)
    for name, true in (("natural_frequencies", np.abs(poles)), ("residues", residues)):
        np.testing.assert_allclose(getattr(result, name), true, rtol=0.1, atol=0.1 * np.abs(true).max())


@pytest.mark.slow
def test_white_noise_gives_no_finding_of_the_recording():
    u, y = recording(3, 3, 2, "white", 0)
    assert not causes(phc.pem((u, y), dt=1.0, structure="free"))
    assert not phc.pem((u, y + 1), dt=1.0, structure="free", offset=True).experiments[0].drifts.any()


def test_a_hit_of_three_samples_leaves_the_modes_where_they_are():
    # what a record does not know of the force between its samples is no noise with a spectrum of its own
    hertz, ratios, fine = np.array([87.3, 161.0, 245.0]), [0.004, 0.006, 0.003], 16
    t = np.arange(4096 * fine) / 2048 / fine
    force = np.where((t > 0.01) & (t < 0.0115), 120 * np.sin(np.pi * (t - 0.01) / 0.0015) ** 2, 0.0)
    omega, shape = 2 * np.pi * hertz, np.array([[0.9], [1.1], [-0.7]])
    plate = phc.from_second_order(
        np.eye(3), np.diag(omega**2), shape, C=np.diag(2 * omega * ratios), sensors={"acceleration": shape.T}
    )  # fmt: skip
    rng, exact = np.random.default_rng(1), phc.forced_response(plate, t, force).outputs[1, ::fine]
    motion = exact + 0.01 * exact.std() * rng.standard_normal(4096)
    result = phc.pem((force[::fine] + 0.1 * rng.standard_normal(4096), motion), dt=1 / 2048, quantity="acceleration")
    assert result.fit_percent > 90
    np.testing.assert_allclose(result.natural_frequencies, omega, rtol=1e-3)
    np.testing.assert_allclose(result.damping_ratios, ratios, rtol=0.15)
