"""
Eight plants
============

The same call, `pem`, for a motor, a filter, an oven, a structure, a bridge in wind, a crystal, a battery and a network.
Each block makes data as an instrument would give them, fits them, and draws measured and fitted side by side. Nothing
is given but the data: no order, no band and no starting values.
"""

import control as ct
import matplotlib.pyplot as plt
import numpy as np
from scipy.signal import welch

import ph_control as phc

rng = np.random.default_rng(0)
panels = {}  # functions that draw on an axis, by name of the plant


def pair(axis, x, measured, fitted, **labels):
    """Measured points, fitted line, labels."""
    axis.plot(x, measured, ".", color="0.6", markersize=4, label="measured")
    axis.plot(x, fitted, color="C0", linewidth=1.3, label="model")
    axis.set(**labels)


def response(values, s):
    """Measured values at s = j omega, with omega in rad/s."""
    data = ct.frd(values, s.imag)
    data.time_unit = "s"
    return data


def noise(shape):
    """Complex white noise of unit variance in both parts."""
    return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)


# %%
# Motor: steps of voltage and the speed. Two time constants, electrical and mechanical.

t = 0.02 * np.arange(1500)
voltage = np.repeat(rng.choice([-1.0, 1.0], 100), 15)
speed = ct.forced_response(ct.c2d(ct.tf([40], [1, 22, 40]), 0.02), t, voltage).outputs
speed = speed + 0.05 * rng.standard_normal(t.size)
motor = phc.pem((voltage, speed), dt=0.02, quantity="free")
print("motor: time constants", motor.time_constants.round(3), "+-", motor.stderr["time_constants"].round(4), "s")
assert len(motor.time_constants) == 2


def draw_motor(axis):
    shown = t < 6
    fitted = motor.predicted.ravel()
    pair(axis, t[shown], speed[shown], fitted[shown], xlabel="Time [s]", ylabel="Speed [rad/s]")
    axis.set_title("Motor: {:.2f} s and {:.3f} s".format(*motor.time_constants))


panels["motor"] = draw_motor

# %%
# Filter: the gain of a band-pass of two coupled circuits, from a network analyser. Resonances with quality factors.

f = np.linspace(80e3, 125e3, 300)
s = 2j * np.pi * f
band_pass = ct.tf([2.5e5, 0, 0], np.polymul([1, 2.5e4, (2 * np.pi * 96e3) ** 2], [1, 2.7e4, (2 * np.pi * 106e3) ** 2]))
band_pass = 1.8e4 * band_pass
gain = band_pass(s) * (1 + 0.01 * noise(f.size)) + 0.003 * noise(f.size)
filtered = phc.pem(response(gain, s), quantity="free")
print("filter:", (1e-3 * filtered.hertz).round(2), "kHz, Q", (0.5 / filtered.damping_ratios).round(1))
assert filtered.order == 2


def draw_filter(axis):
    decibels = [20 * np.log10(np.abs(values.ravel())) for values in (gain, filtered.predicted)]
    pair(axis, 1e-3 * f, *decibels, xlabel="Frequency [kHz]", ylabel="Gain [dB]")
    axis.set_title("Filter: {:.1f} and {:.1f} kHz".format(*(1e-3 * filtered.hertz)))


panels["filter"] = draw_filter

# %%
# Oven: heating power and temperature. A time constant and a dead time.

minutes = np.arange(240) / 6
power = np.repeat(rng.choice([200.0, 600.0], 12), 20)
late = np.r_[np.full(4, power[0]), power[:-4]]  # 40 s
heating = ct.forced_response(ct.c2d(ct.tf([0.3], [240, 1]), 10.0), 10.0 * np.arange(240), late - power[0]).outputs
temperature = 80 + heating + 0.5 * rng.standard_normal(240)
oven = phc.pem((power, temperature), dt=10.0, quantity="free")
print(
    "oven: time constant", oven.time_constants.round(0), "s, dead time", oven.delay, "s, gain", ct.dcgain(oven.system)
)
assert len(oven.time_constants) == 1


def draw_oven(axis):
    fitted = oven.predicted.ravel()
    pair(axis, minutes, temperature, fitted, xlabel="Time [min]", ylabel="Temperature [°C]")
    axis.set_title(f"Oven: {oven.time_constants[0]:.0f} s, late by {oven.delay[0]:.0f} s")


panels["oven"] = draw_oven

# %%
# Structure: force of a shaker and velocity at the top of a frame. Three modes with their damping.

frame = phc.spring_chain([300.0, 200.0, 100.0], 4e5, ground=[6e5, 0, 0], c=150.0, ground_c=[100.0, 0, 0], port=2)
force = 100 * rng.standard_normal(4000)
velocity = phc.forced_response(frame, 0.005 * np.arange(4000), force, intersample="zoh").outputs
velocity = velocity + 0.1 * velocity.std() * rng.standard_normal(4000)
structure = phc.pem((force, velocity), dt=0.005)
print("structure:", (structure.natural_frequencies / (2 * np.pi)).round(3), "Hz,", structure.damping_ratios.round(4))
assert structure.order == 3


def draw_structure(axis):
    block = np.fft.rfft(np.hanning(2000) * np.c_[velocity[:2000], force[:2000], velocity[2000:], force[2000:]].T)
    lines = 0.1 * np.arange(1001)
    estimate = (block[[0, 2]] * block[[1, 3]].conj()).sum(axis=0) / (np.abs(block[[1, 3]]) ** 2).sum(axis=0)
    shown = (lines > 1) & (lines < 25)
    finely = np.linspace(1, 25, 1200)
    axis.semilogy(lines[shown], 1e3 * np.abs(estimate[shown]), ".", color="0.6", markersize=4, label="measured")
    axis.semilogy(finely, 1e3 * np.abs(structure.system(2j * np.pi * finely)), color="C0", linewidth=1.3, label="model")
    axis.set(xlabel="Frequency [Hz]", ylabel="Mobility [mm/s/N]")
    axis.set_title("Structure: {:.2f}, {:.2f}, {:.2f} Hz".format(*structure.natural_frequencies / (2 * np.pi)))


panels["structure"] = draw_structure

# %%
# Bridge in wind: one accelerometer, and no force measured. Modes with their damping.

deck = phc.ph(phc.modes([2 * np.pi * 0.9, 2 * np.pi * 2.3], [1.0, 1.0], damping=[0.015, 0.01]))
sway = phc.forced_response(deck, 0.02 * np.arange(15000), rng.standard_normal(15000), intersample="zoh").outputs[::5]
sway = 0.01 * (sway / sway.std() + 0.1 * rng.standard_normal(sway.size))
bridge = phc.pem((None, sway), dt=0.1, quantity="acceleration")
print("bridge:", (bridge.natural_frequencies / (2 * np.pi)).round(3), "Hz,", bridge.damping_ratios.round(4),
      "+-", bridge.stderr["damping_ratios"].round(4))  # fmt: skip
assert bridge.is_ambient and bridge.order == 2


def draw_bridge(axis):
    lines, density = welch(sway, fs=10.0, nperseg=300)
    axis.semilogy(lines[1:], 1e4 * density[1:], ".", color="0.6", markersize=4, label="measured")
    finely = np.linspace(0.05, 4.9, 800)
    spectrum = np.squeeze(bridge.noise.spectrum(2 * np.pi * finely)).real
    axis.semilogy(finely, 2e4 * spectrum, color="C0", linewidth=1.3, label="model")
    axis.set(xlabel="Frequency [Hz]", ylabel="PSD [(cm/s²)²/Hz]")
    axis.set_title("Bridge in wind: {:.2f} and {:.2f} Hz".format(*bridge.natural_frequencies / (2 * np.pi)))


panels["bridge"] = draw_bridge

# %%
# Crystal: admittance around its resonance. The elements of its equivalent circuit.

f_crystal = np.linspace(9.990e6, 10.030e6, 400)
s_crystal = 2j * np.pi * f_crystal
admittance = s_crystal * 5e-12 + 1 / (15 + s_crystal * 12.665e-3 + 1 / (s_crystal * 20e-15))
admittance = admittance * (1 + 0.003 * noise(400))
crystal = phc.pem(response(admittance, s_crystal))
motional = phc.netlist(crystal.system)
print("crystal:", *(f"{element.name} = {element.value:.4g}" for element in motional.elements),
      f"Cp = {crystal.background.slope[0, 0].real:.3g} F, Q = {0.5 / crystal.damping_ratios[0]:.0f}")  # fmt: skip


def draw_crystal(axis):
    offset = 1e-3 * (f_crystal - 10e6)
    for values, style in ((admittance, dict(marker=".", linestyle="", color="0.6", markersize=4, label="measured")),
                          (crystal.predicted.ravel(), dict(color="C0", linewidth=1.3, label="model"))):  # fmt: skip
        axis.semilogy(offset, 1e3 * np.abs(values), **style)
    axis.set(xlabel="Frequency above 10 MHz [kHz]", ylabel="Admittance [mS]")
    axis.set_title(f"Crystal: Q = {0.5 / crystal.damping_ratios[0]:.0f}")


panels["crystal"] = draw_crystal

# %%
# Battery: impedance spectrum. A resistance and two RC elements.

f_battery = np.geomspace(0.002, 1000, 60)
s_battery = 2j * np.pi * f_battery
impedance = 0.020 + 0.015 / (1 + s_battery * 0.015 * 2.0) + 0.030 / (1 + s_battery * 0.030 * 400)
impedance = impedance * (1 + 0.003 * noise(60))
battery = phc.pem(response(impedance, s_battery))
elements = phc.netlist(battery.system, kind="impedance").elements
print("battery:", *(f"{element.name} = {element.value:.4g}" for element in elements))
assert len(elements) == 5


def draw_battery(axis):
    fitted = battery.system(2j * np.pi * np.geomspace(0.002, 1000, 600))
    axis.plot(1e3 * impedance.real, -1e3 * impedance.imag, ".", color="0.6", markersize=4, label="measured")
    axis.plot(1e3 * fitted.real, -1e3 * fitted.imag, color="C0", linewidth=1.3, label="model")
    axis.set(xlabel="Re Z [mΩ]", ylabel="−Im Z [mΩ]", ylim=(-5, 25))
    axis.set_title("Battery: {:.0f} ms and {:.1f} s".format(*battery.time_constants[::-1] * [1e3, 1]))


panels["battery"] = draw_battery

# %%
# Network: scattering parameters of a low-pass of five elements, as admittances. A passive model of both ports.

board = phc.read_netlist("""low-pass
V1 1 0
V2 4 0
L1 1 2 80n Rser=0.4
C1 2 0 33p
L2 2 3 120n Rser=0.5
C2 3 0 33p
L3 3 4 80n Rser=0.4
.end""")
f_network = np.linspace(2e6, 200e6, 100)
s_network = 2j * np.pi * f_network


def scattering(y):
    """Scattering matrices of admittances (2, 2, lines) in units of 1 / 50 ohm; the same function leads back."""
    y, unit = np.moveaxis(y, 2, 0), np.eye(2)
    return np.moveaxis((unit - y) @ np.linalg.inv(unit + y), 0, 2)


waves = scattering(50 * board(s_network)) + 3e-4 * noise((2, 2, 100))
network = phc.pem(response(scattering(waves) / 50, s_network), ports=[(0, 0), (1, 1)])
print("network:", (1e-6 * network.hertz).round(2), "MHz,", phc.passivity(network.system))
assert network.structure == "passive"


def draw_network(axis):
    model = scattering(50 * network.predicted)
    for row, color, name in ((0, "C0", "$S_{11}$"), (1, "C1", "$S_{21}$")):
        axis.plot(1e-6 * f_network, 20 * np.log10(np.abs(waves[row, 0])), ".", color="0.6", markersize=4)
        axis.plot(1e-6 * f_network, 20 * np.log10(np.abs(model[row, 0])), color=color, linewidth=1.3, label=name)
    axis.set(xlabel="Frequency [MHz]", ylabel="Scattering [dB]", ylim=(-40, 3))
    axis.legend(loc="lower right", fontsize="small")
    axis.set_title("Network: {:.1f}, {:.1f} MHz".format(*1e-6 * network.hertz))


panels["network"] = draw_network

# %%
# All of them.

figure, axes = plt.subplots(2, 4, figsize=(11.5, 5.4), layout="constrained")
for axis, draw in zip(axes.flat, panels.values(), strict=True):
    draw(axis)
    axis.set_title(axis.get_title(), fontsize="medium")
    axis.grid(alpha=0.3)
axes[0, 0].legend(loc="lower right", fontsize="small")
figure.savefig("plants.png", dpi=130)
