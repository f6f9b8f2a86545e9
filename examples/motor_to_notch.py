"""
From a record to a controller: motor with a shaft
=================================================

A motor turns a load through a shaft that twists. One record of torque and load speed gives the slow pole of the drive
and the mode of the shaft, with their errors. A PI controller with a notch at this mode follows a step many times faster
than a PI controller for the slow pole alone, and does so for all drives that the record allows.
"""

import control as ct
import matplotlib.pyplot as plt
import numpy as np

import ph_control as phc

# %%
# The drive only makes the record, and shows at the end what the loops do: two inertias [kg m^2], a shaft, friction.
# States are both speeds and the twist.

step, samples = 0.004, 1200
motor, load, stiffness, damping, friction = 2e-3, 4e-3, 16.0, 2e-3, 6e-3
drive = ct.ss(
    [[-damping / motor, damping / motor, -stiffness / motor],
     [damping / load, -(damping + friction) / load, stiffness / load],
     [1.0, -1.0, 0.0]],
    [[1 / motor], [0.0], [0.0]], [[0.0, 1.0, 0.0]], 0,
)  # fmt: skip
truth = ct.c2d(drive, step)
rng = np.random.default_rng(2)
torque = np.repeat(0.1 * rng.choice([-1.0, 1.0], samples // 3), 3)
speed = np.squeeze(ct.forced_response(truth, inputs=torque).outputs) + 0.5 * rng.standard_normal(samples)

# %%
# The default call finds one mode and one real pole.

columns = {"time [s]": step * np.arange(samples), "torque [N m]": torque, "speed [rad/s]": speed}
result = phc.pem(phc.recording(columns, input="torque", output="speed"), quantity="free")
print(result.summary())
assert (result.order, len(result.real_poles)) == (1, 1)
omega, zeta = result.natural_frequencies[0], result.damping_ratios[0]
error = result.stderr["hertz"][0]
print(f"shaft: {result.hertz[0]:.3f} +- {error:.3f} Hz, damping {100 * zeta:.2f} %; "
      f"time constant of the drive {result.time_constants[0]:.2f} s")  # fmt: skip

# %%
# Designs by python-control. The PI controller cancels the slow pole and crosses over at a chosen frequency; the notch
# takes the mode of the shaft out, with its identified frequency and damping. Tustin's rule takes both to the step of
# the hardware, exact at the frequency of the notch, and the result is applied a sample later.

lag = -result.real_poles[0]
gain = result.residues[-1, 0, 0].real  # the drive without the shaft is gain / (s + lag)
notch = ct.tf([1.0, 2 * zeta * omega, omega**2], [1.0, 2 * 0.7 * omega, omega**2])
later = ct.ss(0, 1, 1, 0, step)


def pi_controller(crossover, with_notch):
    """PI controller [N m per rad/s] for the hardware, with a crossover in Hz."""
    controller = ct.tf(2 * np.pi * crossover / gain * np.array([1.0, lag]), [1.0, 0.0])
    controller = controller * notch if with_notch else controller
    return later * ct.ss(ct.sample_system(controller, step, "tustin", prewarp_frequency=omega))


# %%
# All drives that the record allows: forty draws from the distribution of the fit. Both controllers are as fast as they
# can be with a distance of 0.5 from -1, for all of them and the drive itself.

frequencies = 2 * np.pi * np.unique(np.concatenate([np.geomspace(0.05, 0.5 / step, 500), np.linspace(15, 20, 500)]))
points = np.exp(1j * frequencies * step)
drawn = [ct.c2d(model, step) for model in result.sample_systems(40, rng=1)]
responses = [np.squeeze(plant(points)) for plant in (truth, *drawn)]


def distance(controller):
    """Smallest distance of the open loops from -1; 0 if any closed loop is unstable."""
    if any(np.abs(ct.feedback(plant * controller, 1).poles()).max() >= 1 for plant in (truth, *drawn)):
        return 0.0
    values = np.squeeze(controller(points))
    return min(np.abs(1 + response * values).min() for response in responses)


crossovers = np.geomspace(0.02, 10.0, 60)
controllers, fastest = {}, {}
for name, with_notch in (("PI with notch", True), ("PI", False)):
    allowed = [crossover for crossover in crossovers if distance(pi_controller(crossover, with_notch)) >= 0.5]
    fastest[name] = max(allowed)
    controllers[name] = pi_controller(fastest[name], with_notch)
    print(f"{name}: crossover up to {fastest[name]:.2f} Hz")
assert fastest["PI with notch"] > 5 * fastest["PI"]
assert distance(pi_controller(fastest["PI with notch"], False)) == 0.0

# %%
# A step of the wanted speed in discrete time, with the sample of delay, and the open loops. Bands hold 95 % of the
# drawn drives.

figure, (above, below) = plt.subplots(2, layout="constrained", figsize=(8, 6.5))
time = step * np.arange(500)
above.axhline(10.0, color="0.6", linewidth=1, label="wanted speed")
below.axhline(0.0, color="0.6", linewidth=1)
rise = {}
for (name, controller), color in zip(controllers.items(), ("C0", "C1"), strict=True):
    loops = [ct.feedback(plant * controller, 1) for plant in (truth, *drawn)]
    steps = np.array([np.squeeze(ct.forced_response(loop, inputs=10 * np.ones(time.size)).outputs) for loop in loops])
    opened = 20 * np.log10(np.abs(np.array(responses) * np.squeeze(controller(points))))
    label = f"{name}, crossover {fastest[name]:.2f} Hz"
    for axis, x, values in ((above, time, steps), (below, frequencies / (2 * np.pi), opened)):
        axis.fill_between(x, *np.percentile(values[1:], [2.5, 97.5], axis=0), color=color, alpha=0.35, linewidth=0)
        axis.plot(x, values[0], color=color, label=label)
    rise[name] = time[np.argmax(steps[0] > 6.3)]
print("63 % of the step after", ", ".join(f"{t:.2f} s ({name})" for name, t in rise.items()))
above.set(xlabel="Time [s]", ylabel="Speed of the load [rad/s]", title="Step of the wanted speed")
above.legend(loc="lower right")
below.set(xlabel="Frequency [Hz]", ylabel="Open loop [dB]", title="Open loops; bands hold 95 % of the drives that the "
          "record allows", xscale="log", xlim=(0.05, 0.5 / step))  # fmt: skip
below.set_xticks([0.1, 1, 10, 100], ["0.1", "1", "10", "100"])
for axis in (above, below):
    axis.grid(alpha=0.4)
figure.savefig("motor_to_notch.png", dpi=110)
