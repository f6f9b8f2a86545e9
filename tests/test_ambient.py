"""Outputs alone, kept in motion by forces that nobody measured: modes with errors that hold, and what else is seen."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
from ambient_plant import HERTZ, SHAPES, STEP, ZETA, ambient
from scipy.signal import lfilter
from scipy.stats import chi2
from slow import slowly

import ph_control as phc


def causes(result):
    """Names of what a result found."""
    return [finding.cause.name for finding in result.findings]


@pytest.fixture(scope="module")
def record():
    """One record."""
    return ambient(0)


@pytest.fixture(scope="module")
def fit(record):
    """Its fit by the default call."""
    return phc.pem((None, record), dt=STEP)


# --- modes and their errors ------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_modes_of_ambient_excitation_lie_within_their_intervals():
    z, law = [], []
    for seed in range(2):
        result = phc.pem((None, ambient(seed + 10, 2000)), dt=STEP)
        assert result.order == 3 and result.is_ambient and not len(result.real_poles)
        z += [(result.natural_frequencies / (2 * np.pi) - HERTZ) / (result.stderr["natural_frequencies"] / (2 * np.pi))]
        z += [(result.damping_ratios - ZETA) / result.stderr["damping_ratios"]]
        law.append(result.stderr["damping_ratios"] / result.damping_ratios)
    low, high = chi2.ppf([1e-3, 1 - 1e-3], np.size(z))
    assert low < np.sum(np.square(z)) < high
    # in little noise the coefficient of variation of damping is 1 / sqrt(2 pi zeta N) in N periods
    expected = 1 / np.sqrt(2 * np.pi * ZETA * HERTZ * STEP * 2000)
    assert np.all(np.median(law, axis=0) > 0.75 * expected) and np.all(np.median(law, axis=0) < 1.5 * expected)


@pytest.mark.slow
def test_shapes_are_real_where_the_data_do_not_reject_it(fit, record):
    assert fit.structure == "classical" and fit.tests[0].dof == 6
    assert not fit.shapes.imag.any() and np.all(fit.stderr["shapes"].imag < 1e-12)
    true = SHAPES / SHAPES[np.argmax(np.abs(SHAPES), axis=0), np.arange(3)]
    off, stated = fit.shapes.real - true.T, fit.stderr["shapes"].real
    assert np.all(np.abs(off) <= 4 * stated + 1e-12) and np.sum(stated > 1e-12) == 6
    free = phc.pem((None, record), 3, dt=STEP, structure="free")
    assert free.structure == "free" and not free.tests and free.loglik >= fit.loglik
    np.testing.assert_allclose(2 * (free.loglik - fit.loglik), fit.tests[0].likelihood_ratio, atol=0.01)
    assert free.unknowns == fit.unknowns + 6


@pytest.mark.slow
def test_complex_shapes_reject_real_ones():
    y = ambient(4, 4000, of_displacement=0.5)
    result = phc.pem((None, y), 3, dt=STEP)
    assert result.structure == "free" and "COMPLEX_SHAPES" in causes(result) and result.tests[0].p < 1e-6
    given = phc.pem((None, y), 3, dt=STEP, structure="classical")
    assert given.structure == "classical" and given.loglik < result.loglik - 10


@pytest.mark.slow
def test_units_of_the_outputs_and_of_time_change_nothing_else(fit, record):
    scaled = phc.pem((None, record * np.array([[1e-9], [1.0], [1e6]])), 3, dt=STEP * 1e-3)
    hundredth = 10 * fit.stderr["natural_frequencies"]  # of a standard error: so far searches come
    assert np.all(np.abs(scaled.natural_frequencies - 1e3 * fit.natural_frequencies) < hundredth)
    np.testing.assert_allclose(scaled.stderr["damping_ratios"], fit.stderr["damping_ratios"], rtol=1e-3)
    sizes = np.log([1e-9, 1.0, 1e6]).sum() * record.shape[1]
    np.testing.assert_allclose(scaled.loglik, fit.loglik - sizes, rtol=0, atol=0.01)


@pytest.mark.slow
def test_several_recordings_have_one_model():
    parts = [(None, ambient(seed, 1500)) for seed in (21, 22)]
    both = phc.pem(parts, 3, dt=STEP)
    assert both.order == 3 and len(both.experiments) == 2
    alone = phc.pem(parts[0], 3, dt=STEP)
    np.testing.assert_allclose(both.stderr["damping_ratios"], alone.stderr["damping_ratios"] / np.sqrt(2), rtol=0.5)


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize("outputs", [1, 8])
def test_one_output_or_many(outputs):
    shapes = np.random.default_rng(5).standard_normal((outputs, 3))
    result = phc.pem((None, ambient(5, 2000, shapes=shapes)), dt=STEP)
    assert result.order == 3 and result.is_ambient
    assert result.structure == ("free" if outputs == 1 else "classical")
    assert np.all(np.abs(result.damping_ratios - ZETA) < 4 * result.stderr["damping_ratios"])


# --- sensors that move -----------------------------------------------------------------------------------------------

PLACES = np.vstack([SHAPES, [[0.6, 0.9, 0.1], [0.9, -0.2, 0.8]]])


def set_ups(seed, rows, sizes, samples=1500, shapes=PLACES, tone=0.0):
    """Recordings of some places each, in forces of some sizes, with a tone of 6.1 Hz in all of them."""
    recordings, t = [], STEP * np.arange(samples)
    for k, (places, size) in enumerate(zip(rows, sizes, strict=True)):
        y = ambient([seed, k], samples, shapes=shapes)[places]
        y = size * (y + tone * y.std(axis=1, keepdims=True) * np.sin(2 * np.pi * 6.1 * t + k))
        names = [f"place {place}" for place in places]
        recordings.append(phc.recording(dict(zip(names, y, strict=True)), False, names, time=False, dt=STEP))
    return recordings


@pytest.fixture(scope="module")
def moved():
    """Fit of two set-ups with one sensor that stays; the wind is three times as strong in the second."""
    return phc.pem(set_ups(3, ([0, 1, 3], [0, 2, 4]), (1.0, 3.0)), max_order=4)


def test_set_ups_with_a_sensor_that_stays_have_one_set_of_modes(moved):
    assert (moved.order, len(moved.real_poles), moved.structure) == (3, 0, "classical") and moved.is_ambient
    order = [moved.output_labels.index(f"place {place}") for place in range(5)]
    shapes, stated = moved.shapes.real[:, order], moved.stderr["shapes"].real[:, order]
    largest = np.argmax(np.abs(shapes), axis=1)
    true = PLACES.T / PLACES.T[np.arange(3), largest][:, None]
    free = stated > 1e-9
    z = np.concatenate([
        (moved.natural_frequencies / (2 * np.pi) - HERTZ) / (moved.stderr["natural_frequencies"] / (2 * np.pi)),
        (moved.damping_ratios - ZETA) / moved.stderr["damping_ratios"], (shapes - true)[free] / stated[free],
    ])  # fmt: skip
    assert free.sum() == 12
    low, high = chi2.ppf([1e-3, 1 - 1e-3], len(z))
    assert low < np.sum(z**2) < high and moved.whiteness > 1e-3


def test_what_a_set_up_did_not_measure_is_not_predicted(moved, tmp_path):
    seen = [np.isfinite(experiment.predicted).all(axis=1) for experiment in moved.experiments]
    assert [each.sum() for each in seen] == [3, 3] and np.any(seen, axis=0).all() and np.all(seen, axis=0).sum() == 1
    assert np.isfinite(moved.fit_percent) and np.all(moved.noise_variance > 0)
    for name in ("predictor", "kalman_gain"):
        with pytest.raises(phc.NoSuchQuantityError, match="fit one of them"):
            getattr(moved, name)
    phc.save(moved, tmp_path / "moved.json")
    again = phc.load(tmp_path / "moved.json")
    assert again.noise is None and np.array_equal(again.poles, moved.poles)
    plt.close(phc.shape_plot(moved).figure)


def test_a_machine_in_all_set_ups_is_named_and_is_no_mode():
    result = phc.pem(set_ups(4, ([0, 1], [0, 2]), (1.0, 1.0), 1000, SHAPES, tone=0.5), noise="forces", max_order=4)
    assert result.order == 3 and causes(result).count("HUM") == 2
    (tone,) = {hum.values[0] for hum in result.findings if hum.cause.name == "HUM"}
    assert abs(tone / (2 * np.pi) - 6.1) < 0.002


@pytest.mark.slow
def test_a_mode_at_whose_node_the_sensor_stays_has_no_shape_but_is_no_two_modes():
    shapes = PLACES * (1 - np.outer(np.arange(5) == 0, np.arange(3) == 1))
    result = phc.pem(set_ups(1, ([0, 1, 2], [0, 3, 4]), (1.0, 1.0), 2500, shapes))
    assert result.order == 3 and not len(result.real_poles)
    assert result.stderr["shapes"][1].real.max() > 5 * result.stderr["shapes"][[0, 2]].real.max()
    assert np.all(np.abs(result.damping_ratios - ZETA) < 4 * result.stderr["damping_ratios"])


def test_set_ups_without_a_sensor_in_common_are_refused():
    with pytest.raises(phc.StructureError, match="an output in common"):
        phc.pem(set_ups(0, ([0, 1], [2, 3]), (1.0, 1.0), 300), noise="forces")


# --- what is ambient, and what is not --------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_free_decay_is_none(fit):
    t = STEP * np.arange(1500)
    decays = np.exp(np.outer(2 * np.pi * HERTZ * (-ZETA + 1j * np.sqrt(1 - ZETA**2)), t)).real
    y = SHAPES @ decays
    y += 0.3 * y.std() * np.random.default_rng(0).standard_normal(y.shape)
    result = phc.pem((None, y), dt=STEP)
    assert result.order == 3 and not result.is_ambient and "in free motion" in result.summary()
    assert "under ambient excitation" in fit.summary()


def test_a_decay_in_the_wind_is_ambient():
    t = STEP * np.arange(1500)
    decays = np.exp(np.outer(2 * np.pi * HERTZ * (-ZETA + 1j * np.sqrt(1 - ZETA**2)), t)).real
    result = phc.pem((None, 30 * SHAPES @ decays + ambient(1, 1500)), dt=STEP)
    assert result.order == 3 and result.is_ambient and "CHANGING_MODE" not in causes(result)
    assert np.all(np.abs(result.damping_ratios - ZETA) < 3 * result.stderr["damping_ratios"])


@pytest.mark.parametrize("seed", [2, *slowly(0)])
def test_a_tone_takes_no_mode_of_little_damping_along(seed):
    t, zeta = STEP * np.arange(2000), np.array([0.002, 0.012, 0.015])
    y = ambient(seed, 2000, zeta=zeta)
    y += 0.5 * y.std(axis=1, keepdims=True) * np.sin(2 * np.pi * 6.1 * t + np.arange(3)[:, None])
    result = phc.pem((None, y), dt=STEP)
    assert result.order == 3 and causes(result).count("HUM") == 1
    assert np.all(np.abs(result.damping_ratios - zeta) < 3 * result.stderr["damping_ratios"])


def test_white_noise_has_no_modes():
    y = np.linalg.cholesky(0.5 * np.eye(2) + 0.5) @ np.random.default_rng(1).standard_normal((2, 1000))
    for noise in ("auto", "forces"):
        result = phc.pem((None, y), dt=1.0, noise=noise)
        assert result.states == 0 and result.outcome.name == "NOTHING" and "0 modes" in result.summary()


def test_a_fit_of_a_single_sensor_comes_back_from_a_file(tmp_path):
    noise = np.random.default_rng(0).standard_normal(800)
    result = phc.pem((None, lfilter([1], [1, -1.8, 0.9], noise)), 1, dt=1.0)
    assert result.is_ambient and not result.experiments[0].initial_state.size
    phc.save(result, tmp_path / "sensor.json")
    again = phc.load(tmp_path / "sensor.json")
    assert np.array_equal(again.poles, result.poles) and again.summary() == result.summary()


@pytest.mark.slow
def test_a_wind_that_is_not_white_is_a_real_pole():
    y = lfilter([1], [1, -0.95], np.random.default_rng(2).standard_normal(3000))
    result = phc.pem((None, y), dt=1.0)
    assert result.order == 0 and result.is_ambient and len(result.real_poles) == 1
    assert abs(result.real_poles[0] - np.log(0.95)) < 4 * result.stderr["real_poles"][0]


@pytest.mark.slow
def test_a_machine_is_named_and_is_no_mode():
    y, t = ambient(6, 4000), STEP * np.arange(4000)
    y += np.array([[0.5], [0.3], [-0.4]]) * y.std(axis=1, keepdims=True) * np.sin(2 * np.pi * 6.1 * t + 1)
    result = phc.pem((None, y), dt=STEP)
    assert result.order == 3 and causes(result).count("HUM") == 1
    (hum,) = [finding for finding in result.findings if finding.cause.name == "HUM"]
    assert abs(hum.values[0] / (2 * np.pi) - 6.1) < 0.002
    sizes = np.hypot(*np.reshape(hum.values[1:], (3, 2)).T) / y.std(axis=1)
    np.testing.assert_allclose(sizes, [0.5, 0.3, 0.4], atol=0.1)
    assert np.all(np.abs(result.damping_ratios - ZETA) < 4 * result.stderr["damping_ratios"])


# --- circumstances ---------------------------------------------------------------------------------------------------

BESIDE = {"AMBIENT", "COMPLEX_SHAPES"}  # what clean records may show


def the(result, cause):
    """The one finding of a cause."""
    (finding,) = [finding for finding in result.findings if finding.cause.name == cause]
    return finding


def holds(result):
    """Whether modes are those of the plant."""
    off = result.natural_frequencies / (2 * np.pi) - HERTZ, result.damping_ratios - ZETA
    stated = result.stderr["natural_frequencies"] / (2 * np.pi), result.stderr["damping_ratios"]
    return all(np.all(np.abs(part) < 4 * error) for part, error in zip(off, stated, strict=True))


@pytest.fixture(scope="module")
def clean():
    """A record in little noise."""
    return ambient(31, 2000, noise=0.05)


@pytest.fixture(scope="module")
def steady(clean):
    """Its fit."""
    return phc.pem((None, clean), 3, dt=STEP, noise="forces")


def test_wild_values_are_named_and_may_be_marked_as_missing(clean):
    wild = clean[:, :1000].copy()
    wild[1, [500, 901]] += 10 * clean[1].std() * np.array([1, -1])
    result = phc.pem((None, wild), 3, dt=STEP)
    finding = the(result, "OUTLIERS")
    assert finding.values == (500, 901) and finding.output == "y2" and result.outcome.name == "DOUBTFUL"
    assert "mark them with NaN" in result.message and result.message.startswith("Doubtful, as some values")
    wild[1, [500, 901]] = np.nan
    again = phc.pem((None, wild), 3, dt=STEP)
    assert again.is_ambient and holds(again)
    assert set(causes(again)) <= BESIDE and again.outcome.name == "CONSISTENT"


def test_missing_samples_take_no_more_than_what_they_would_tell(clean, steady):
    gaps = clean.copy()
    gaps[0, np.random.default_rng(0).choice(2000, 60, replace=False)] = np.nan
    gaps[:, 700:720] = np.nan
    whole, result = steady, phc.pem((None, gaps), 3, dt=STEP, noise="forces")
    for name in ("natural_frequencies", "damping_ratios"):
        off = getattr(result, name) - getattr(whole, name)
        assert np.all(np.abs(off) < 0.4 * whole.stderr[name])
        np.testing.assert_allclose(result.stderr[name], whole.stderr[name], rtol=0.1)
    assert np.isfinite(result.predicted).all() and np.isnan(result.residuals[:, 700:720]).all()
    assert result.noise_variance == pytest.approx(whole.noise_variance, rel=0.06)


def test_forces_that_grow_are_named_and_weighted(clean, steady):
    gust = np.concatenate([clean[:, :1000], 3 * clean[:, 1000:]], axis=1)
    result = phc.pem((None, gust), 3, dt=STEP, noise="forces")
    finding = the(result, "CHANGING_FORCES")
    starts, sizes = np.reshape(finding.values, (-1, 2)).T
    assert starts[0] == 0 and abs(starts[1] - 1000) < 20 and abs(sizes[1] / sizes[0] - 3) < 0.4
    assert finding.gain > 100 and "forces are not steady" in result.message
    # each half counts as it did
    np.testing.assert_allclose(result.stderr["damping_ratios"], steady.stderr["damping_ratios"], rtol=0.1)
    assert np.all(np.abs(result.damping_ratios - steady.damping_ratios) < 0.5 * steady.stderr["damping_ratios"])
    assert len(result.experiments) == 1 and result.residuals.shape == gust.shape and result.predictor.nstates


def test_noise_of_a_sensor_that_grows_for_a_while_is_named(clean):
    loud = clean.copy()
    loud[2, 600:1200] += 0.5 * clean[2].std() * np.random.default_rng(0).standard_normal(600)
    result = phc.pem((None, loud), 3, dt=STEP, noise="forces")
    finding = max((each for each in result.findings if each.cause.name == "CHANGING_NOISE"), key=lambda f: f.output)
    starts = finding.values[::2]
    assert finding.output == "y3" and abs(starts[1] - 600) < 20 and abs(starts[2] - 1200) < 20
    assert not finding.gain and "OUTLIERS" not in causes(result) and "loose cable" in result.message


@pytest.mark.slow
def test_a_sensor_that_drifts_is_named_and_gives_no_mode(clean, tmp_path):
    t, size = STEP * np.arange(2000), clean[2].std()
    leaning = clean.copy()
    leaning[2] += size * (t / t[-1] - 0.5) * 5
    result = phc.pem((None, leaning), dt=STEP)
    slopes = np.array(the(result, "DRIFT").values)
    assert result.order == 3 and not len(result.real_poles) and holds(result)
    np.testing.assert_allclose(slopes, [0, 0, 5 * size / t[-1]], atol=0.1 * size / t[-1])
    phc.save(result, tmp_path / "fit.json")
    assert phc.load(tmp_path / "fit.json").summary() == result.summary()
    wandering = clean.copy()
    wandering[2] += 0.05 * size * np.cumsum(np.random.default_rng(0).standard_normal(2000))
    result = phc.pem((None, wandering), dt=STEP)
    assert result.order == 3 and the(result, "SLOW_NOISE").output == "y3" and holds(result)
    assert "a drift or coloured noise of the sensor" in result.message


@pytest.mark.parametrize("kind", ["clipped", "stuck", "dead"])
def test_a_sensor_that_fails_is_named(clean, kind):
    y = clean.copy()
    if kind == "dead":
        y[1] = 0.3
        with pytest.raises(phc.IdentificationError, match="'y2' is constant"):
            phc.pem((None, y), dt=STEP)
        return
    if kind == "clipped":
        y[1] = np.clip(y[1], *(1.8 * y[1].std() * np.array([-1, 1])))
    else:
        y[1, 1500:] = y[1, 1500]
    result = phc.pem((None, y), dt=STEP, noise="forces", max_order=4)
    finding = the(result, "SATURATION" if kind == "clipped" else "STUCK")
    assert finding.output == "y2" and result.outcome.name == "DOUBTFUL"
    assert kind == "clipped" or finding.values == (1500, 500, y[1, 1500])


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_a_clean_record_shows_no_circumstance(seed):
    result = phc.pem((None, ambient(seed + 50, 1500, noise=0.05)), dt=STEP, noise="forces")
    assert set(causes(result)) <= BESIDE and result.outcome.name == "CONSISTENT"


# --- options, and errors ---------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_orders_that_are_given_are_taken(record):
    assert phc.pem((None, record), 2, dt=STEP, noise="forces").order == 2
    result = phc.pem((None, record), 3, dt=STEP, real_poles=1)
    assert result.order == 3 and len(result.real_poles) == 1
    short = phc.pem((None, record), dt=STEP, max_order=2, real_poles=0)
    assert short.order == 2 and "LARGEST_ORDER" in causes(short)


@pytest.mark.variants
@pytest.mark.parametrize("criterion", ["aic", "aicc", "holdout"])
def test_every_criterion_chooses(record, criterion):
    assert phc.pem((None, record), dt=STEP, criterion=criterion, noise="forces").order >= 3


@pytest.mark.variants
@pytest.mark.parametrize("calls", [2, 12])
def test_an_interruption_leaves_the_best_model_so_far(record, calls):
    seen = []

    def callback(progress):
        seen.append(progress)
        if len(seen) == calls:
            raise StopIteration

    result = phc.pem((None, record), dt=STEP, noise="forces", callback=callback)
    assert len(seen) == calls and not result.success and result.outcome.name == "INTERRUPTED"
    assert result.states > 0 and "interrupted" in result.message


def test_what_no_model_describes_is_refused_with_a_reason(record):
    missing = record.copy()
    missing[0, ::5] = np.nan
    with pytest.raises(phc.StructureError, match="no more than 10 % of the samples"):
        phc.pem((None, missing), dt=STEP, noise="forces")
    for data in (record[:, :9], np.concatenate([record, record[:1] - record[1:2]])):
        with pytest.raises(phc.IdentificationError, match=r"record longer|combination of others"):
            phc.pem((None, data), dt=STEP, noise="forces")


def test_results_of_ambient_excitation_have_what_others_have(fit, record, tmp_path):
    phc.save(fit, tmp_path / "fit.json")
    again = phc.load(tmp_path / "fit.json")
    assert again.is_ambient and np.array_equal(again.poles, fit.poles) and again.summary() == fit.summary()
    np.testing.assert_allclose(np.diag(fit.mac(again)), 1)
    diagram = fit.stabilisation(beyond=2)
    assert diagram.order == 3 and list(diagram.orders[-3:]) == [3, 4, 5]
    # one order higher the modes of the result stay
    assert np.sum(diagram.stability[list(diagram.orders).index(4)] >= 1) >= 3
    for plot in (fit.plot(), diagram.plot(), phc.shape_plot(fit), phc.residual_plot(fit)):
        plt.close(plot.figure)
    table = phc.fit_many([(None, record[:, :1000]), (None, ambient(7, 1000))], order=3, dt=STEP, noise="forces")
    assert len(table.table) == 6 and not len(table.failures)
    assert fit.residuals.shape == record.shape and fit.whiteness > 1e-3
    with pytest.raises(phc.StructureError, match="forces that nobody measured"):
        fit.bootstrap(10)


@pytest.mark.parametrize(("outputs", "modes", "samples"), [(1, 5, 1000), *slowly((1, 6, 2000), (2, 6, 2000))])
def test_a_decay_of_many_modes_in_little_noise_is_no_ambient_motion(outputs, modes, samples):
    w, zeta = np.array([0.037, 0.12, 0.22, 0.28, 0.33, 0.78]), np.array([0.003, 0.002, 0.002, 0.003, 0.028, 0.007])
    rng = np.random.default_rng(outputs)
    c = rng.uniform(0.5, 1.5, (outputs, 6)) * np.exp(1j * rng.uniform(0.0, 2 * np.pi, (outputs, 6)))
    w, zeta, c = w[:modes], zeta[:modes], c[:, :modes]
    y = 2 * (c @ np.exp(np.outer(w * (-zeta + 1j * np.sqrt(1 - zeta**2)), np.arange(samples)))).real
    y += 0.004 * y.std(axis=1, keepdims=True) * rng.standard_normal(y.shape)
    fit = phc.pem((None, y), dt=1.0)
    assert fit.order == modes and not {"AMBIENT", "FORCES"} & {finding.cause.name for finding in fit.findings}
    assert fit.outcome.name == "CONSISTENT"
    assert np.all(np.abs(fit.natural_frequencies - w) < 4.5 * fit.stderr["natural_frequencies"])


def test_a_decay_of_four_modes_that_hardly_decays_did_not_end_at_a_largest_order():
    t, rng = 0.1 * np.arange(1000), np.random.default_rng(0)
    y = np.exp(-0.002 * t) * sum(np.cos(w * t + k) for k, w in enumerate((2.0, 5.0, 9.0, 13.0)))
    fit = phc.pem((None, y + 0.05 * rng.standard_normal(1000)), dt=0.1)
    assert fit.order == 4 and not fit.is_ambient and "LARGEST_ORDER" not in causes(fit)
