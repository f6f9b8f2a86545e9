"""Options that are not what they should be are refused by name, all over the package."""

import matplotlib.pyplot as plt
import numpy as np
import pytest

import ph_control as phc

NOT_BOOLEAN = [2, -1, 0.5, "no", None, np.nan, [], [True], np.array([True, False])]
NO_SEED = [np.array([[1, 2]]).view(np.matrix), np.ones((2, 2), int), [1.5], "3", -1, np.nan, object()]


@pytest.fixture(scope="module")
def record():
    rng = np.random.default_rng(0)
    u = rng.standard_normal(200)
    plant = phc.ph(phc.modes([0.5, 2.0], [1.0, 0.25]))
    return plant, u, phc.forced_response(plant, 0.1 * np.arange(200), u).outputs + 0.05 * rng.standard_normal(200)


def _calls(plant, u, y, folder):
    data, one = (u, y), phc.modes(1.0, 1.0)
    fit = phc.pem(data, 2, dt=0.1)
    table = folder / "recording.csv"
    table.write_text("t,u,y\n" + "".join(f"{0.1 * k},{u[k]},{y[k]}\n" for k in range(9)))
    return {
        "offset": [
            lambda v: phc.pem(data, 2, dt=0.1, offset=v), lambda v: phc.compare(data, plant, dt=0.1, offset=v),
            lambda v: phc.residual_analysis(data, plant, dt=0.1, offset=v),
            lambda v: phc.order_selection(data, 2, dt=0.1, offset=v),
        ],
        "overwrite": [
            lambda v: phc.save(one, folder / "one.json", overwrite=v),
            lambda v: phc.netlist(plant).save(folder / "plant.cir", overwrite=v),
            lambda v: fit.report(folder / "fit.html", overwrite=v),
        ],
        "header": [lambda v: phc.read_csv(table, header=v if v is not None else 2)],
        "returnall": [lambda v: phc.stability_margins(plant, returnall=v)],
        "residual_modes": [
            lambda v: phc.from_second_order(np.eye(2), np.diag([1, 2]), [1, 1], modes=1, residual_modes=v)
        ],
        "condense": [lambda v: phc.from_second_order(np.eye(2), np.eye(2), [1, 0], condense=v)],
        "Hz": [lambda v, f=f: f(plant, Hz=2 if v is None else v) for f in (phc.modes_plot, phc.pole_zero_plot)],
    } | {
        name: [lambda v, name=name: phc.bode_plot(plant, **{name: v})]
        for name in ("dB", "deg", "plot_magnitude", "plot_phase", "wrap_phase", "display_margins")
    }  # fmt: skip


@pytest.mark.slow
def test_an_option_that_is_neither_true_nor_false_is_refused_by_name(record, tmp_path):
    for name, calls in _calls(*record, tmp_path).items():
        for call in calls:
            for value in NOT_BOOLEAN:
                with pytest.raises(phc.StructureError, match=f"{name} is .*must be True"):
                    call(value)
            call(np.True_)
            plt.close("all")
    assert list(tmp_path.glob("*.json")) == [tmp_path / "one.json"]


def test_what_is_no_source_of_random_numbers_is_refused(record):
    _, u, y = record
    fit = phc.pem((u, y), 2, dt=0.1, rng=[1, 2])
    for value in NO_SEED:
        for call in (
            lambda v: phc.pem((u, y), 2, dt=0.1, rng=v), lambda v: fit.sample(2, rng=v),
            lambda v: fit.bootstrap(2, rng=v), lambda v: phc.gradient_descent((u, y), 1, dt=0.1, epochs=1, rng=v),
        ):  # fmt: skip
            with pytest.raises(phc.StructureError, match="rng is"):
                call(value)


def test_what_is_no_order_no_label_and_no_map_is_refused(record):
    plant, u, y = record
    for value in (np.array(["auto"]), np.ones(3), "best", 2.0, None, []):
        with pytest.raises(phc.StructureError, match="order is"):
            phc.pem((u, y), value, dt=0.1)
    with pytest.raises(phc.StructureError, match="orders is"):
        phc.order_selection((u, y), np.array([2])[0:1].reshape(()), dt=0.1)
    with pytest.raises(phc.StructureError, match="range of doubles"):
        phc.excitation((u, y), ([1.0], [1e300]), dt=0.1)
    for value in (np.array([[50]]), 2.5, 0, True):
        with pytest.raises(phc.StructureError, match=r"omega_num is .* whole number of at least 1"):
            phc.bode_plot(plant, omega_num=value)
    with pytest.raises(phc.StructureError, match="label is"):
        phc.compare((u, y), plant, dt=0.1, labels=np.array(2))
    with pytest.raises(phc.StructureError, match="workers is"):
        phc.pem((u, y), 2, dt=0.1).bootstrap(2, rng=1, workers=lambda: None)


@pytest.mark.variants
@pytest.mark.parametrize(
    "workers", [lambda f, items: None, lambda f, items: [f(items[0])], lambda f, items: [None] * len(items)]
)
def test_a_map_that_does_not_give_one_result_each_is_refused(record, workers):
    _, u, y = record
    with pytest.raises(phc.StructureError, match="workers is to give one result for each of 5 items"):
        phc.pem((u, y), 2, dt=0.1).bootstrap(5, rng=1, workers=workers)
