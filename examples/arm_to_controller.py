"""
From a record to a controller: flexible arm
===========================================

A flexible arm in gusts, with a bus that delivers its speed two samples late. One record gives the plant, the delay and
the forces that nobody measured; its predictor gives a controller that leaves a whole sample for computing. The same
steps with python-control alone, which know nothing of the delay, stand beside it, and both face all arms that the
record allows.
"""

import control as ct
import matplotlib.pyplot as plt
import numpy as np

import ph_control as phc

# %%
# Two modes from the torque of the motor to its speed, sampled 50 times a second. This arm only makes the record, and
# shows at the end what the loops do.

step, samples, late = 0.02, 1500, 2
omega = 2 * np.pi * np.array([1.1, 4.7])
arm = phc.ph(phc.modes(omega, np.array([2.0, 1.0]) / omega, damping=[0.02, 0.015]))


def delayed(count):
    """A delay of so many samples."""
    return ct.ss(np.eye(count, k=-1), np.eye(count, 1), np.eye(1, count, count - 1), 0, step)


truth = delayed(late) * phc.sample(arm, step)
rng = np.random.default_rng(1)
torque = np.repeat(rng.choice([-1.0, 1.0], samples // 5), 5)
gusts = 0.5 * rng.standard_normal(samples)
speed = ct.forced_response(truth, inputs=torque + gusts).outputs + 0.01 * rng.standard_normal(samples)

# %%
# The record says its names and units. The default call finds two modes, the delay, and forces on the arm; as the speed
# is measured where the torque acts, the model is port-Hamiltonian, and `sample` takes it to discrete time.

columns = {"time [s]": step * np.arange(samples), "torque [N m]": torque, "speed [rad/s]": speed}
record = phc.recording(columns, input="torque", output="speed")
result = phc.pem(record, ports=[(0, 0)])
print(result.summary())
print(result.noise)
print(f"delay {result.delay[0] / step:.3f} samples")
assert result.order == 2 and isinstance(result.system, phc.PortHamiltonian)
assert round(result.delay[0] / step) == late

# %%
# Linear quadratic control on the states of the predictor: those of the arm, and the torques that are still under way.
# The predictor tells the states at a sample from the outputs *before* it, so that the controller has one whole sample
# for its sums.

effort = 0.3
predictor = result.predictor
gain = predictor.B[:, 1:]
A, B, C = predictor.A + gain @ predictor.C, predictor.B[:, :1], predictor.C
feedback, _, _ = ct.dlqr(A, B, C.T @ C, [[effort]])
identified = ct.ss(A - B @ feedback - gain @ C, gain, feedback, 0, step)

# %%
# The textbook with python-control: the same modes without the delay, white forces at the motor and a white sensor, a
# regulator and a Kalman filter in continuous time, Tustin's rule. Its sums take a sample as well.

model = ct.ss(result.system.A, result.system.B, result.system.C, 0)
regulator, _, _ = ct.lqr(model.A, model.B, model.C.T @ model.C, [[effort]])
observer, _, _ = ct.lqe(model.A, model.B, model.C, [[0.5**2 * step]], [[0.01**2 * step]])
continuous = ct.ss(model.A - model.B @ regulator - observer @ model.C, observer, regulator, 0)
plain = delayed(1) * ct.sample_system(continuous, step, "tustin")

# %%
# Margins on the arm as it is, and on forty arms drawn from the distribution of the fit: the smallest distance d of the
# open loop from -1. The gain may grow by 1 / (1 - d), and the phase fall by 2 arcsin(d / 2), before a loop is unstable.

omega = np.unique(np.concatenate([np.geomspace(1.25, np.pi / step, 400), np.linspace(26.0, 33.0, 300)]))
points = np.exp(1j * omega * step)


def distance(plant, controller):
    """Smallest distance of the open loop from -1 on the unit circle; 0 if the closed loop is unstable."""
    stable = np.abs(ct.feedback(plant, controller).poles()).max() < 1
    return stable * np.abs(1 + np.squeeze(plant(points) * controller(points))).min()


drawn = [delayed(late) * phc.sample(model, step) for model in result.sample_systems(40, rng=1)]
controllers = {"identified delay and forces": identified, "python-control, textbook": plain}
margins = {}
for name, controller in controllers.items():
    margins[name] = min(distance(plant, controller) for plant in (truth, *drawn))
    factor, angle = 1 / (1 - margins[name]), np.degrees(2 * np.arcsin(margins[name] / 2))
    print(f"{name}: distance {distance(truth, controller):.2f}, at least {margins[name]:.2f} with all drawn arms: gain "
          f"margin {factor:.1f}, phase margin {angle:.0f} degrees")  # fmt: skip
assert margins["identified delay and forces"] > 0.7 > 0.5 > margins["python-control, textbook"]

# %%
# In discrete time, with all delays: the speed after a torque of 1 N m that stays, and the response of the speed to a
# torque, on the arm as it is. Bands hold 95 % of the drawn arms: next to the second mode they are wider than a line.

figure, axes = plt.subplot_mosaic([["above", "above"], ["below", "near"]], layout="constrained", figsize=(9, 6.5))
above, below, near = axes.values()
time = step * np.arange(150)


def shown(plant):
    """Speed after a step of torque [rad/s], and size of the response [dB]."""
    stepped = np.squeeze(ct.forced_response(plant, inputs=np.ones(time.size)).outputs)
    return stepped, 20 * np.log10(np.abs(np.squeeze(plant(points))))


free = shown(truth)
above.step(time, free[0], color="0.6", linewidth=1, where="post", label="without control")
for axis in (below, near):
    axis.semilogx(omega / (2 * np.pi), free[1], color="0.6", linewidth=1)
damped = {}
for (name, controller), color in zip(controllers.items(), ("C0", "C1"), strict=True):
    bands = np.array([np.concatenate(shown(ct.feedback(plant, controller))) for plant in drawn])
    low, high = np.split(np.percentile(bands, [2.5, 97.5], axis=0), [time.size], axis=1)
    stepped, size = shown(ct.feedback(truth, controller))
    damped[name] = np.max(size)
    above.fill_between(time, *low, step="post", alpha=0.35, color=color, linewidth=0)
    above.step(time, stepped, color=color, where="post", label=name)
    for axis in (below, near):
        axis.fill_between(omega / (2 * np.pi), *high, alpha=0.35, color=color, linewidth=0)
        axis.plot(omega / (2 * np.pi), size, color=color)
print(f"peak of the response: {np.max(free[1]):.1f} dB without control, "
      + ", ".join(f"{size:.1f} dB with {name}" for name, size in damped.items()))  # fmt: skip
assert damped["identified delay and forces"] < min(np.max(free[1]) - 10, damped["python-control, textbook"])
above.set(xlabel="Time [s]", ylabel="Speed [rad/s]", title="Torque of 1 N m from time 0 on")
above.set_ylim(top=0.58)
above.legend(loc="upper right", ncols=3, fontsize="small")
below.set(xlabel="Frequency [Hz]", ylabel="Speed / torque [dB]", title="0 dB is 1 rad/s per N m")
below.set_xticks([0.2, 0.5, 1, 2, 5, 10, 20], ["0.2", "0.5", "1", "2", "5", "10", "20"])
near.set(xlabel="Frequency [Hz]", ylabel="Speed / torque [dB]", title="Second mode with bands of 95 %",
         xlim=(4.4, 5.0), ylim=(-18, 22), xscale="linear")  # fmt: skip
for axis in axes.values():
    axis.grid(alpha=0.4)
figure.savefig("arm_to_controller.png", dpi=110)
