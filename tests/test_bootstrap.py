"""Residual bootstrap against covariances, dense weighted least squares, `pem` itself, and by hand."""

import dataclasses
from functools import partial
from multiprocessing.pool import ThreadPool

import control as ct
import numpy as np
import pytest
from known import KNOWN
from slow import slowly

import ph_control as phc
from ph_control.identification.fit import bootstrap as module
from ph_control.identification.regression.time_rows import FreeRecord
from ph_control.identification.structure.constrained import constrained

lossless_fit = partial(phc.pem, structure="lossless")

STEP = 0.1
SEED_OF_A_NEGATIVE_WEIGHT = 4  # of the estimate, were it free
MODES = phc.modes([1.0, 2.3], [1.0, 0.4])

# how the records were made, so that fits need not look for it


def recording(samples=300, noise=0.1, seed=0, modes=MODES, state=None, method="exact"):
    """White force on a plant, its velocity and white noise."""
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(samples)
    start = np.zeros(2 * modes.n) if state is None else state
    y = phc.forced_response(
        phc.ph(modes), STEP * np.arange(samples), u, start, method=method, intersample="zoh"
    ).outputs
    return u, y + noise * rng.standard_normal(samples)


def response(noise=0.02, seed=0, weighted=True):
    """A measured frequency response whose noise grows with the frequency, and the weights that undo it."""
    rng = np.random.default_rng(seed)
    omega = np.linspace(0.31, 3.51, 81)
    level = noise * omega if weighted else noise * np.ones(81)
    values = MODES.freqresp(omega) + level * (rng.standard_normal(81) + 1j * rng.standard_normal(81))
    return ct.frd(values, omega, smooth=False), 1 / level**2


def missing(u, y, every=7):
    return u, np.where(np.arange(len(y)) % every == 3, np.nan, y)


def fits():
    """A result of every kind of data and option, by name."""
    u, y = recording(state=[1.0, -0.5, 0.3, 0.2])
    free = phc.initial_response(phc.ph(MODES), STEP * np.arange(200), [1.0, 2.0, 0.0, 1.0]).outputs
    free = free + 0.1 * np.random.default_rng(5).standard_normal(200)
    frd, weights = response()
    return {
        "plain": lambda: lossless_fit((u, y), 2, dt=STEP, **KNOWN),
        "from rest": lambda: lossless_fit(recording(), 2, dt=STEP, initial_state="zero", **KNOWN),
        "offset": lambda: lossless_fit((u, y + 3.0), 2, dt=STEP, offset=True, **KNOWN),
        "missing": lambda: lossless_fit(missing(u, y), 2, dt=STEP, **KNOWN),
        "several": lambda: lossless_fit(
            [(u, y), recording(150, seed=3), (None, free)], 2, dt=[STEP, STEP, STEP], **KNOWN
        ),
        "several from rest": lambda: lossless_fit(
            [recording(150, seed=3), (None, free)], 2, dt=STEP, initial_state="zero", offset=True, **KNOWN
        ),
        "acceleration": lambda: lossless_fit(accelerations(), 2, dt=STEP, quantity="acceleration", **KNOWN),
        "displacement, foh": lambda: lossless_fit(
            displacements(), 2, dt=STEP, quantity="displacement", intersample="foh"
        ),
        "midpoint": lambda: lossless_fit(recording(method="midpoint"), 2, dt=STEP, method="midpoint"),
        "free": lambda: lossless_fit((None, free), 2, dt=STEP),
        "response": lambda: lossless_fit(frd, 2, weights=weights),
        "held": lambda: lossless_fit(unreached(), 2, dt=STEP, **KNOWN),
        "classical": lambda: phc.pem(damped(), 1, dt=STEP, structure="classical", **KNOWN),
        "passive": lambda: phc.pem(damped(), 1, dt=STEP, structure="passive", **KNOWN),
        "real pole": lambda: phc.pem(lag(), 1, dt=STEP, real_poles=1, structure="free"),
        "channels": lambda: phc.pem(channels(), 2, dt=STEP, structure="free", offset=True, **KNOWN),
        "late": lambda: phc.pem(late(), 1, dt=STEP, structure="free", delay=3.4 * STEP),
        "background": lambda: phc.pem(coil(), 1, structure="free"),
    }  # fmt: skip


KINDS = sorted(fits())


@pytest.fixture(scope="module")
def fitted():
    """Results, made once."""
    made, ways = {}, fits()
    return lambda kind: made.setdefault(kind, ways[kind]())


def unreached(samples=300):
    """A record of two modes that move, the second out of reach of the input; noise lets it look a little negative."""
    rng = np.random.default_rng(SEED_OF_A_NEGATIVE_WEIGHT)
    u, t = rng.standard_normal(samples), STEP * np.arange(samples)
    y = phc.forced_response(phc.ph(phc.modes(1.0, 1.0)), t, u, [0.5, 0.2], intersample="zoh").outputs + 2 * np.cos(
        2.3 * t
    )
    return u, y + 0.1 * rng.standard_normal(samples)


def damped(samples=300):
    rng = np.random.default_rng(11)
    u, plant = rng.standard_normal(samples), phc.ph(phc.modes(1.0, 1.0, damping=0.05))
    y = phc.forced_response(plant, STEP * np.arange(samples), u, intersample="zoh").outputs
    return u, y + 0.1 * rng.standard_normal(samples)


def lag(samples=400):
    """A record of a mode beside a slow pole without another."""
    rng = np.random.default_rng(12)
    u, plant = rng.standard_normal(samples), ct.tf([1.0, 0.0], [1.0, 0.1, 4.0]) + ct.tf([0.5], [1.0, 0.3])
    y = ct.forced_response(ct.sample_system(ct.ss(plant), STEP, "zoh"), STEP * np.arange(samples), u).outputs
    return u, y + 0.05 * rng.standard_normal(samples)


def channels(samples=300):
    """Two inputs and two outputs of different size, one of which misses samples, about constants."""
    rng = np.random.default_rng(13)
    poles, u = np.array([-0.03 + 1j, -0.05 + 2.3j]), rng.standard_normal((2, samples))
    residues = rng.standard_normal((2, 2, 2)) + 1j * rng.standard_normal((2, 2, 2))
    residues[:, 1] *= 10
    y = np.zeros((2, samples))
    for p, rho in zip(poles, residues, strict=True):
        state = np.zeros(2, complex)
        for k in range(samples):
            y[:, k] += 2 * (rho @ state).real
            state = np.exp(p * STEP) * state + np.expm1(p * STEP) / p * u[:, k]
    y += np.array([[0.1], [1.0]]) * rng.standard_normal(y.shape) + np.array([[2.0], [-3.0]])
    y[1, ::5] = np.nan
    return u, y


def late(samples=300):
    """A record whose output comes three samples and a part later."""
    rng = np.random.default_rng(14)
    fine = np.repeat(rng.standard_normal(samples), 10)
    t = STEP / 10 * np.arange(10 * samples)
    y = phc.forced_response(phc.ph(phc.modes(1.0, 1.0, damping=0.05)), t, fine, intersample="zoh").outputs
    y = np.concatenate([np.zeros(34), y])[: len(t) : 10]
    return fine[::10], y + 0.05 * rng.standard_normal(samples)


def coil():
    """A response of a coil in series with what resonates."""
    s, rng = 1j * np.linspace(0.1, 3.0, 200), np.random.default_rng(15)
    noise = 5e-3 * (rng.standard_normal(200) + 1j * rng.standard_normal(200))
    return ct.frd(s / (s**2 + 0.08 * s + 1) + 0.05 * s + noise, s.imag, smooth=False)


def displacements(samples=250):
    """A record of the position of the port, under an input that is linear between samples."""
    rng = np.random.default_rng(3)
    plant, u = phc.ph(MODES), rng.standard_normal(samples)
    x = phc.forced_response(plant, STEP * np.arange(samples), u, intersample="foh").x
    return u, np.linalg.solve(plant.A.T, plant.C[0]) @ x + 0.05 * rng.standard_normal(samples)


def near(first, second, resamples, spare=0.0):
    """Whether two standard errors agree as far as a number of resamples tells, four standard deviations of it."""
    ratio = np.asarray(first) / np.asarray(second)
    return np.all(np.abs(ratio - 1) < 4 / np.sqrt(2 * resamples) + spare)


# --- the problem, made again -----------------------------------------------------------------------------------------


@pytest.mark.variants
@pytest.mark.parametrize("kind", KINDS)
def test_the_problem_made_again_has_its_minimum_at_the_result(kind, fitted):
    result = fitted(kind)
    refit = module._Refit.of(result)
    scales = refit.layout.scales
    for one, predicted, place in zip(refit.rows, refit.predictions, refit.places, strict=True):
        expected = result.experiments[place].predicted.reshape(len(scales), -1)[one.outputs]
        values = scales[one.outputs, None] * (one.placed(predicted) if isinstance(one, FreeRecord) else predicted)
        assert np.allclose(values, expected, rtol=0, atol=1e-9 * np.nanmax(np.abs(expected)), equal_nan=True)
    poles, residues, through, motions, offsets = refit.fitted(refit.rows)
    errors = result.stderr
    assert np.all(np.abs(np.abs(poles) - np.abs(result.poles))[: result.order] <= 1e-3 * errors["d"])
    size = np.abs(result.residues).max(initial=0.0)
    assert np.allclose(residues, result.residues, rtol=0, atol=1e-3 * size)
    assert np.allclose(through, result.feedthrough, rtol=0, atol=1e-3 * size)
    again = module._with_estimate(result, poles, residues, through, motions, offsets)
    for one, data in zip(again.experiments, result.experiments, strict=True):
        assert np.allclose(one.free_amplitudes, data.free_amplitudes, rtol=1e-3, atol=1e-3)
    assert np.allclose(again.offsets, result.offsets, rtol=1e-3, atol=1e-4)


@pytest.mark.variants
@pytest.mark.parametrize("kind", KINDS)
def test_records_from_rest_are_told_from_others(kind, fitted):
    rows = module._Refit.of(fitted(kind)).rows
    assert any(one.driven and not one.moving for one in rows if isinstance(one, FreeRecord)) == kind.endswith(
        "from rest"
    )


# --- white noise: the standard errors of theory ----------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.variants
@pytest.mark.parametrize(
    "kind",
    [
        "plain",
        "several from rest",
        "response",
        "channels",
        *slowly("missing", "free", "acceleration", "classical", "late", "background", "real pole"),
    ],
)
def test_under_white_noise_the_bootstrap_gives_the_standard_errors_of_the_covariance(kind, fitted):
    # records whose noise is white and as large everywhere
    result = fitted(kind)
    again = result.bootstrap(60, rng=1)
    assert again.failed == 0 and len(again) == 60
    for name in again.stderr:
        expected, found = result.stderr[name], again.stderr[name]
        assert found.shape == np.shape(expected)
        for one, other in ((found.real, np.real(expected)), (np.imag(found), np.imag(expected))):
            known = np.isfinite(other) & (other > 0)
            assert not np.any(one[~known]), name
            # experiments keep their own noise level, known to sqrt(2/150) of its square
            spare = 0.15 if len(result.experiments) > 1 else 0.0
            assert near(one[known], other[known], 60, spare), name


def accelerations():
    u, _ = recording(250)
    plant = phc.ph(MODES)
    observed = ct.ss(plant.A, plant.B, plant.C @ plant.A, plant.C @ plant.B)
    y = ct.forced_response(ct.sample_system(observed, STEP, "zoh"), STEP * np.arange(250), u).outputs
    return u, y + 0.1 * np.random.default_rng(9).standard_normal(250)


@pytest.mark.slow
def test_percentile_intervals_under_white_noise_are_those_of_the_normal_distribution(fitted):
    result = fitted("plain")
    again = result.bootstrap(100, rng=2)
    for level, spread in ((0.5, 0.14), (0.9, 0.22)):
        boot, normal = again.interval(level), result.confidence_interval(level)
        for name in ("d", "r", "initial_state"):
            error = result.stderr[name][..., None]
            assert boot[name].shape == normal[name].shape
            assert np.abs((boot[name] - normal[name]) / error).max() < 3.5 * spread


@pytest.mark.slow
def test_the_noise_that_is_drawn_has_the_variance_of_the_noise_and_no_mean(fitted):
    for kind in ("plain", "offset", "missing"):
        result, refit = fitted(kind), module._Refit.of(fitted(kind))
        noise = refit.layout.scales[0] * refit.noise[0]
        left = result.residuals[result.record.observed]
        factor = result.noise_variance[0] / np.mean(left**2)
        assert abs(noise.mean()) < 1e-12 * noise.std()
        assert abs(noise.var() / (result.noise_variance[0] - factor * np.mean(left) ** 2) - 1) < 1e-10


# --- where it rightly differs ----------------------------------------------------------------------------------------


def dense_errors(result, levels):
    """Standard errors of weighted least squares, experiments having noise of these levels: dense, by differences."""
    n, count = result.order, len(result.experiments)

    def predicted(theta):
        plant = phc.ph(phc.modes(theta[:n], theta[n : 2 * n]))
        states = theta[2 * n :].reshape(count, 2 * n)
        parts = [
            phc.forced_response(plant, data.record.time, data.record.u, state, intersample="zoh").outputs / level
            for data, state, level in zip(result.experiments, states, levels, strict=True)
        ]
        return np.concatenate(parts)

    theta = np.concatenate([result.d, result.r, *result.initial_states])
    step = 1e-5
    J = np.array([(predicted(theta + e) - predicted(theta - e)) / (2 * step) for e in step * np.eye(len(theta))]).T
    return np.sqrt(np.diag(np.linalg.inv(J.T @ J)))


@pytest.mark.slow
def test_experiments_with_noise_of_their_own_have_errors_of_their_own():
    levels = 0.1, 0.6
    data = [recording(400, levels[0], 1), recording(120, levels[1], 2)]
    result = lossless_fit(data, 2, dt=STEP, **KNOWN)
    expected = dense_errors(result, levels)
    again = result.bootstrap(40, rng=3)
    names = "d", "r", "initial_state"
    boot, stated = (np.concatenate([of.stderr[name].ravel() for name in names]) for of in (again, result))
    # of 120 residuals the level is known to 1/sqrt(240)
    assert near(boot, expected, 40, 3 / np.sqrt(240)) and near(stated, expected, 120, 3 / np.sqrt(240))


@pytest.mark.slow
def test_where_two_errors_outweigh_all_others_the_estimate_often_does_not_move():
    """Of 60 residuals 2 are large: resamples without any of them, `(58/60)^60` = 13 %, end next to the estimate."""
    modes = phc.modes(1.0, 1.0)
    u, y = recording(60, 0.0, modes=modes)
    share = {}
    for kind in ("normal", "spikes"):
        noise = 0.1 * np.random.default_rng(8).standard_normal(60)
        if kind == "spikes":
            noise *= 0.01
            noise[[17, 41]] = 0.5, -0.5
        result = lossless_fit((u, y + noise), 1, dt=STEP, initial_guess=modes, initial_state="zero", **KNOWN)
        draws = result.bootstrap(40, rng=1)
        share[kind] = np.mean(np.abs(draws.d[:, 0] - result.d) < 0.03 * draws.stderr["d"])
    chance = (58 / 60) ** 60
    assert abs(share["spikes"] - chance) < 2 * np.sqrt(chance * (1 - chance) / 40) + 0.024
    assert share["normal"] < 0.1


# --- resamples and refits --------------------------------------------------------------------------------------------


@pytest.fixture
def problems(monkeypatch):
    """The rows that are refitted, as they pass."""
    seen, original = [], module._Refit.fitted

    def watched(self, rows):
        seen.append(rows)
        return original(self, rows)

    monkeypatch.setattr(module._Refit, "fitted", watched)
    return seen


@pytest.mark.variants
@pytest.mark.parametrize("kind", ["offset", "missing"])
def test_each_resample_is_the_prediction_with_residuals_of_the_record_and_is_fitted_as_pem_does(kind, fitted, problems):
    result = fitted(kind)
    again = result.bootstrap(3, rng=7)
    scale, observed = module._Refit.of(result).layout.scales[0], result.record.observed
    left = result.residuals[observed]
    pool = np.sqrt(result.noise_variance[0] / np.mean(left**2)) * (left - left.mean())
    drawn = []
    for k, (one,) in enumerate(problems):
        assert np.array_equal(one.observed, observed) and np.array_equal(one.u[0], result.record.u)
        y = scale * one.y[0]
        distance = np.abs((y - result.predicted)[observed][:, None] - pool)
        assert distance.min(axis=1).max() < 1e-12
        drawn.append(distance.argmin(axis=1))
        assert 0.5 < len(np.unique(drawn[-1])) / observed.sum() < 0.75  # 1 - 1/e of them, with replacement
        again_y = np.where(observed, y, np.nan)
        full = lossless_fit(
            (result.record.u, again_y), 2, dt=STEP, offset=kind == "offset", initial_guess=result.modes, **KNOWN
        )
        for name, value, stderr in (
            ("d", again.d[k], full.stderr["d"]), ("r", again.r[k], full.stderr["r"]),
            ("initial_state", again.initial_state[k], full.stderr["initial_state"]),
            ("offsets", again.offset[k], full.stderr["offset"]),
        ):  # fmt: skip
            allowed = np.where(np.isnan(stderr), 0.0, 1e-3 * stderr)
            assert np.all(np.abs(value - getattr(full, name)) <= allowed), name
    assert len({tuple(places) for places in drawn}) == 3


def test_residuals_of_a_response_are_drawn_as_complex_numbers_in_units_of_their_weights(fitted, problems):
    result = fitted("response")
    result.bootstrap(3, rng=7)
    left = result.residuals * np.sqrt(result.record.weights)
    pool = np.sqrt(result.noise_variance[0, 0] / result.loss) * (left - left.mean())
    scale = module._Refit.of(result).layout.scales[0]
    for (rows,) in problems:
        noise = (scale * rows.response[0] - result.predicted) * np.sqrt(result.record.weights)
        assert np.abs(noise[:, None] - pool).min(axis=1).max() < 1e-10
        assert np.ptp(rows.scale / np.sqrt(result.record.weights)) < 1e-12 * rows.scale.max()


def test_residuals_stay_within_their_experiment(problems):
    data = [recording(100, 0.05, 1), recording(100, 0.5, 2)]
    result = lossless_fit(data, 2, dt=STEP, initial_guess=MODES, **KNOWN)
    result.bootstrap(3, rng=0)
    scale = module._Refit.of(result).layout.scales[0]
    for rows in problems:
        quiet, loud = (
            np.std(scale * data.noise_scale * one.y[0] - data.predicted)
            for one, data in zip(rows, result.experiments, strict=True)
        )
        assert quiet < 0.4 * loud


@pytest.mark.slow
def test_modes_are_matched_in_order_even_where_resamples_exchange_them():
    # two modes as far apart as their errors
    u, y = recording(300, 0.3, seed=6, modes=phc.modes([1.0, 1.08], [1.0, 1.0]))
    again = lossless_fit((u, y), 2, dt=STEP, offset=False, **KNOWN).bootstrap(12, rng=0)
    kept = again.d[~np.isnan(again.d[:, 0])]
    assert np.all(np.diff(kept, axis=1) >= 0)


@pytest.mark.slow
def test_weights_that_are_held_are_reported(fitted):
    """Where the estimate is on the bound, resamples of it fall on either side."""
    held, free = (fitted(kind).bootstrap(20, rng=0) for kind in ("held", "plain"))
    assert fitted("held").r[1] == 0
    assert np.array_equal(free.active_share, [0.0, 0.0]) and held.active_share[0] == 0
    assert 0.2 < held.active_share[1]
    assert np.array_equal(held.active_share, (held.r[~np.isnan(held.r[:, 0])] == 0).mean(axis=0))
    assert f"0, {100 * held.active_share[1]:.0f} %" in repr(held)


@pytest.mark.slow
def test_a_weight_near_zero_is_held_in_some_of_the_resamples():
    u, y = recording(200, 0.5, seed=1, modes=phc.modes([1.0, 2.3], [1.0, 0.02]))
    result = lossless_fit((u, y), 2, dt=STEP, initial_guess=([1.0, 2.3], [1.0, 1.0]), **KNOWN)
    again = result.bootstrap(30, rng=0)
    assert 0.05 < again.active_share[1] < 0.95


# --- seeds and workers -----------------------------------------------------------------------------------------------


def parts(bootstrap):
    return [getattr(bootstrap, field.name) for field in dataclasses.fields(bootstrap)]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["several", *slowly("response")])
def test_the_answer_does_not_depend_on_the_workers(kind, fitted):
    result = fitted(kind)
    alone = result.bootstrap(6, rng=5)
    with ThreadPool(3) as pool:
        for workers in (2, map, pool.map):
            for first, second in zip(parts(alone), parts(result.bootstrap(6, rng=5, workers=workers)), strict=True):
                assert np.array_equal(first, second)


def test_more_resamples_begin_with_the_same_ones(fitted):
    few, many = (fitted("plain").bootstrap(k, rng=5) for k in (4, 9))
    assert np.array_equal(few.d, many.d[:4]) and not np.array_equal(many.d[4], many.d[5])


def test_seeds_generators_and_none(fitted):
    result = fitted("plain")
    seeded = result.bootstrap(3, rng=5)
    assert np.array_equal(seeded.d, result.bootstrap(3, rng=np.random.default_rng(5)).d)
    assert not np.array_equal(seeded.d, result.bootstrap(3, rng=6).d)
    assert not np.array_equal(result.bootstrap(3).d, result.bootstrap(3).d)


@pytest.mark.slow
def test_a_result_from_a_file_is_resampled_alike(fitted, tmp_path):
    for kind in ("several", "response"):
        fitted(kind).save(tmp_path / f"{kind}.json")
        loaded = phc.load(tmp_path / f"{kind}.json")
        assert np.array_equal(loaded.bootstrap(3, rng=1).d, fitted(kind).bootstrap(3, rng=1).d)


# --- refits that fail ------------------------------------------------------------------------------------------------


def every_third(monkeypatch, how):
    count = iter(range(10**6))
    monkeypatch.setattr(module, "constrained", lambda *a, **k: (how if next(count) % 3 == 0 else constrained)(*a, **k))


def unconverged(*args, **kwargs):
    return dataclasses.replace(constrained(*args, **kwargs), converged=False)


def breaks_down(*args, **kwargs):
    raise np.linalg.LinAlgError("SVD did not converge")


@pytest.mark.slow
@pytest.mark.parametrize("how", [breaks_down, *slowly(unconverged)])
def test_refits_that_fail_are_counted_and_left_out(how, fitted, monkeypatch):
    whole = fitted("several").bootstrap(12, rng=5)
    every_third(monkeypatch, how)
    again = fitted("several").bootstrap(12, rng=5)
    assert (again.failed, len(again), len(again.d)) == (4, 8, 12)
    kept = np.arange(12) % 3 > 0
    for name in ("poles", "residues", "d", "r", "initial_state", "offset"):
        assert np.isnan(getattr(again, name)[~kept]).all()
        assert np.array_equal(getattr(again, name)[kept], getattr(whole, name)[kept])
    assert np.allclose(again.stderr["d"], np.std(whole.d[kept], axis=0, ddof=1), rtol=1e-12, atol=0)
    assert np.array_equal(again.interval(0.5)["d"], np.quantile(whole.d[kept], [0.25, 0.75], axis=0).T)
    assert len(again.samples) == 8
    assert "4 failed" in repr(again)


def test_without_a_refit_there_are_no_statistics(fitted, monkeypatch):
    monkeypatch.setattr(module, "constrained", breaks_down_always)
    again = fitted("plain").bootstrap(3, rng=0)
    assert again.failed == 3 and len(again) == 0
    assert np.isnan(again.stderr["d"]).all() and np.isnan(again.active_share).all()
    with pytest.raises(phc.StructureError, match="none of 3 refits converged"):
        again.interval()


def breaks_down_always(*args, **kwargs):
    raise RuntimeError("too many iterations")


def test_an_interruption_ends_the_bootstrap(fitted, monkeypatch):
    def stopped(*arguments, **keywords):
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "constrained", stopped)
    with pytest.raises(KeyboardInterrupt):
        fitted("plain").bootstrap(3, rng=0)


def test_an_estimate_off_the_minimum_is_refused(fitted):
    cut = dataclasses.replace(fitted("plain"), success=False)
    with pytest.raises(phc.IdentificationError, match="not a minimum of its loss"):
        cut.bootstrap(2, rng=0)


# --- what is handed out ----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_bands_hold_the_refitted_models(fitted):
    again = fitted("plain").bootstrap(20, rng=0)
    omega = np.array([0.4, 1.7, 3.0])
    gains = np.abs([phc.modes(d, r).freqresp(omega) for d, r in zip(again.d, again.r, strict=True)])
    band = again.samples.magnitude_band(omega, 0.8)
    assert np.allclose(band, np.quantile(gains, [0.1, 0.9], axis=0), rtol=1e-12, atol=0)
    assert again.samples.delay.tolist() == [0.0] and fitted("late").bootstrap(2, rng=0).samples.delay[0] > 0


def test_nothing_is_modified_and_nothing_can_be(fitted):
    result = fitted("plain")
    before = result.d.copy(), result.residuals.copy(), result.record.y.copy()
    again = result.bootstrap(3, rng=0)
    assert all(map(np.array_equal, before, (result.d, result.residuals, result.record.y)))
    for array in (again.poles, again.residues, again.r, again.initial_state, again.offset, again.stderr["d"]):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
    with pytest.raises(dataclasses.FrozenInstanceError):
        again.d = before[0]


def test_one_resample_has_no_standard_error(fitted):
    assert np.isnan(fitted("plain").bootstrap(1, rng=0).stderr["d"]).all()


@pytest.mark.variants
@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"k": 0}, "at least one"), ({"k": -1}, "k is -1"), ({"k": 2.5}, "k is 2.5"), ({"k": True}, "k is True"),
        ({"rng": "seed"}, "rng is"), ({"rng": -1}, "rng is"),
        ({"workers": 0}, "workers is 0"), ({"workers": 1.5}, "workers is 1.5"), ({"workers": True}, "workers is True"),
    ],
)  # fmt: skip
def test_arguments_that_make_no_sense_are_refused(arguments, message, fitted):
    with pytest.raises(phc.StructureError, match=message):
        fitted("plain").bootstrap(**{"k": 2} | arguments)


@pytest.mark.variants
@pytest.mark.parametrize("level", [0, 1, 1.5, None, "0.9"])
def test_a_level_is_a_number_between_0_and_1(level, fitted):
    with pytest.raises(phc.StructureError, match="level is"):
        fitted("plain").bootstrap(2, rng=0).interval(level)
