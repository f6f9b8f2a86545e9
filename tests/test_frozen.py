"""Whatever the package returns can be copied, pickled and sent to another process, and comes back as locked."""

import copy
import multiprocessing
import pickle
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor

import control as ct
import numpy as np
import pytest

import ph_control as phc

THROUGH = {"pickle": lambda x: pickle.loads(pickle.dumps(x)), "deepcopy": copy.deepcopy, "copy": copy.copy}


def _results():
    rng = np.random.default_rng(0)
    plant = phc.ph(phc.modes([0.5, 2.0], [1.0, 0.25]))
    t, u, w = 0.1 * np.arange(300), rng.standard_normal(300), np.linspace(0.1, 3.0, 100)
    response = phc.forced_response(plant, t, u)
    y = response.outputs + 0.05 * rng.standard_normal(300)
    noise = 0.1 * (rng.standard_normal(100) + 1j * rng.standard_normal(100))
    fits = [
        phc.pem((u, y), 2, dt=0.1),
        phc.pem([(u, y), (u[:200], y[:200])], 2, dt=0.1, offset=True),
        phc.pem(ct.frd(plant(1j * w) + noise, w), 2),
        phc.pem((u, y * np.exp(-0.05 * t)), 2, dt=0.1),
        phc.pem((u, np.stack([y, -y])), 2, dt=0.1, structure="free"),
    ]
    canonical = phc.ch([1.0, 2.0], [1.0, 1.0, 1.0, 1.0])
    many = phc.fit_many([(u, y)], dt=0.1, order=2, reference=fits[0])
    start = [0.52, 1.9], [1.0, 1.0, 1.0, 1.0], [0.0, 0.0, 0.0, 0.0]
    bootstrap = fits[0].bootstrap(10, rng=1)
    fixture = ct.frd(plant(1j * w) + 0.3 + 0.2j * w + noise, w)
    background = phc.pem(fixture, structure="free").experiments[0].background
    resonator = phc.read_netlist("V1 1 0\nL1 1 2 1\nC1 2 0 1\nR1 2 0 9\n", parameters=["C1"])
    updated = phc.update_model(lambda theta: phc.ph(phc.modes(theta, [1.0, 1.0])), [0.5, 2.0], fits[0])
    return [
        *fits, bootstrap, bootstrap.stderr, fits[1].bootstrap(10, rng=1).interval(), fits[0].confidence_interval(),
        fits[0].sample(3, rng=1), fits[-1].sample(3, rng=1),
        phc.excitation((u, None), 1, dt=0.1).information, *(fit.experiments[0] for fit in fits),
        *(fit.record for fit in fits[2:]), phc.compare((u, y), fits[0], plant, dt=0.1),
        phc.residual_analysis((u, y), fits[0], dt=0.1), phc.order_selection((u, y), 2, dt=0.1),
        phc.from_second_order(np.eye(2), np.diag([1.0, 4.0]), base=[1.0, 1.0]).base_motion,
        phc.design_input(fits[0], 60, 0.1, peak=1.0, for_="natural_frequencies"),
        phc.excitation((u, None), phc.modes(1.0, 1.0, damping=0.1), dt=0.1),
        phc.excitation((u, None), 1, dt=0.1), phc.NoiseModel([[1.0]], 0.1, [[0.5]]),
        many, many.track(shortest=1), many.changes(), fits[0].changed((u, y)), fits[0].compare(fits[1]),
        fits[0].stabilisation(1),
        phc.RecordingFitted(1, 0, None, "name", "message"),
        phc.optimal_damping(phc.spring_chain([1.0, 2.0], ground=1.0)),
        phc.UniversalModes(_locked([-0.1 + 1j]), _locked([[1.0 + 0j]]), _locked([2j]), ("1+Z",)),
        phc.gradient_descent((u, y), 2, initial_guess=start, dt=0.1, epochs=3), phc.energy_balance(response, plant),
        phc.spectral_estimate(response), plant, plant.modes,
        phc.ph(np.eye(2), [0.0, 1.0], R=np.eye(2)), phc.passivity(ct.ss(-1.0, 1.0, 1.0, 0.0)),
        plant.modes.scaled_coefficients()[0], phc.netlist(plant), canonical,
        phc.from_second_order(np.eye(2), np.diag([1.0, 4.0]), [1.0, 1.0], modes=1).structural_modes,
        phc.SecondOrderSystem(np.eye(2), np.diag([1.0, 4.0]), [1.0, 1.0]), background,
        phc.oh([1.0, 2.0], [1.0, 1.0, 1.0, 1.0]), phc.affine(np.diag([4.0, 1.0]), [1.0, 0.0]),
        phc.is_even(phc.affine(np.diag([4.0, 1.0]), [1.0, 0.0])), phc.kalman_decomposition(plant),
        phc.canonical_margins(plant), phc.split_casimirs(np.eye(3), [1, 0, 0], [[0, 1, 0], [-1, 0, 0], [0, 0, 0]]),
        phc.expressive_power([1.0, 2.0], [1.0, 1.0, 0.0, 0.0]), phc.is_morphism(np.eye(4), plant, plant),
        phc.are_isomorphic(plant, plant), phc.PortHamiltonianGroupoid(np.eye(4), plant),
        phc.ReducedGroupoid(np.eye(2), np.eye(4), [1.0, 2.0], [1.0, 1.0, 1.0, 1.0]),
        phc.StructureError("refused"), phc.NotLosslessError(("it is damped",)), phc.IdentificationError("refused"),
        phc.NotPassiveError([(0.0, 1.0)], [0.5], [0.5], [1.0 + 2.0j], (-1,), ("it is active",)),
        phc.FileFormatError("refused"), phc.FileMissingError("refused"), phc.OutputExistsError("refused"),
        phc.MissingPackageError("refused"), phc.UnknownKeywordError("refused"), phc.NoSuchQuantityError("none"),
        phc.PHControlError("refused"), phc.IdentifiabilityWarning("told"), phc.ResolutionWarning("told"),
        phc.ConditioningWarning("told"), resonator, updated, updated.fitted_parameters,
    ]  # fmt: skip


def _locked(values):
    array = np.array(values)
    array.setflags(write=False)
    return array


@pytest.fixture(scope="module")
def results():
    """Some of every public class, and what they hold."""
    return _results()


def _arrays(thing, path="", seen=None):
    """Arrays that can be reached from an object, by the path to them, and whether they are locked."""
    seen = {} if seen is None else seen
    if isinstance(thing, np.ndarray):
        return {path: not thing.flags.writeable}
    if id(thing) in seen or isinstance(thing, type) or callable(thing):
        return {}
    seen[id(thing)] = thing
    inside = dict(enumerate(thing)) if isinstance(thing, tuple | list) else {}
    inside |= dict(thing) if isinstance(thing, Mapping) else {}
    inside |= vars(thing) if hasattr(thing, "__dict__") else {}
    found = {}
    for name, part in inside.items():
        found |= _arrays(part, f"{path}/{name}", seen)
    return found


def _held_against(twin, original):
    assert type(twin) is type(original)
    before, after = _arrays(original), _arrays(twin)
    assert [path for path in before if path in after and before[path] != after[path]] == []
    assert str(twin) == str(original)


def test_the_table_has_every_public_class(results):
    public = {value for name in phc.__all__ if isinstance(value := getattr(phc, name), type)}
    assert public - {kind for one in results for kind in type(one).__mro__} == set()


@pytest.mark.parametrize("how", THROUGH)
def test_what_is_returned_comes_back_as_locked_as_it_was(results, how):
    for one in results:
        _held_against(THROUGH[how](one), one)


@pytest.mark.slow
def test_what_is_returned_comes_back_from_another_process(results):
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        for one, twin in zip(results, pool.map(copy.copy, results), strict=True):
            _held_against(twin, one)
        record = results[0].record
        fit = pool.submit(phc.pem, (record.u, record.y), 2, dt=0.1).result()
    assert np.array_equal(fit.d, results[0].d)
    with pytest.raises(ValueError, match="read-only"):
        fit.stderr["d"][0] = 0.0


def test_standard_errors_are_a_mapping_that_cannot_change(results):
    for mapping in (results[0].stderr, results[0].confidence_interval()):
        assert {"d", "r", "initial_state", "offset", "natural_frequencies"} <= set(mapping)
        assert repr(mapping) == repr(dict(mapping))
        with pytest.raises(TypeError):
            mapping["d"] = None
        with pytest.raises(KeyError):
            mapping["damping"]
