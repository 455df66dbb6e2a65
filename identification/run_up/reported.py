"""Reported values of a passage: conversion of the unknowns to reported units, and selection of determined values."""

from __future__ import annotations

import numpy as np

from identification.errors import NotIdentifiable
from identification.run_up.design import Design
from identification.run_up.forced_oscillator import Excitation
from identification.run_up.model import ANGLE, AXIS_PRIOR_STD, DELAYS, RIPPLE
from rig_basics.units import TO_RPM

_FALSE_ALARM_RATE = 1e-5  # probability that noise alone counts as a resonance


def reported(design: Design, mark_rad: float) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Names, values, and derivatives ∂values/∂unknowns of shape (k, unknowns)."""
    structure, p = design.structure, design.nonlinear
    theta = structure.theta(design.phi)
    names = ["f1_Hz", "zeta1", "f2_Hz", "zeta2", "axis_angle_deg"]
    scale = np.r_[np.exp(theta[:4]) / np.array([2 * np.pi, 1, 2 * np.pi, 1]), np.degrees(1.0)]
    values = [*scale[:4], np.degrees(theta[ANGLE])]
    linear = np.zeros((len(names), design.unknowns - p))
    rows: list[np.ndarray] = list(np.hstack([scale[:, None] * structure.spread[:5], linear]))
    at = p
    sizes, turns = list[float](), list[float]()
    # the phase is fixed at the marks; ripple between them is counted from there
    pull = 2 * np.array([np.sin(mark_rad), np.cos(mark_rad), np.sin(2 * mark_rad), np.cos(2 * mark_rad)])
    pull = np.degrees(np.nan_to_num(pull))
    for c in design.coefficients:
        size, units = _polar(c[:2])
        for unit in units:
            row = np.zeros(design.unknowns)
            row[at : at + 2] = unit
            rows.append(row)
        rows[-1][:p] += pull @ structure.spread[RIPPLE]
        sizes.append(size)
        turns.append(float(np.degrees(np.arctan2(c[1], c[0])) + pull @ theta[RIPPLE]))
        at += len(c)
    names += ["amplitude_x_m", "phase_x_deg", "amplitude_y_m", "phase_y_deg"]
    values += [sizes[0], turns[0], sizes[1], turns[1]]
    parts = (("run_out", structure.run_out_at), ("bow", structure.bow_at), ("growing", structure.growing_at))
    for kind, part in parts:
        at = p
        for axis, c in zip("xy", design.coefficients, strict=True):
            if part.stop > part.start:
                names += [f"{kind}_{axis}_m", f"{kind}_{axis}_deg"]
                size, units = _polar(c[part])
                values += [size, float(np.degrees(np.arctan2(c[part][1], c[part][0])) + pull @ theta[RIPPLE])]
                for unit in units:
                    row = np.zeros(design.unknowns)
                    row[at + part.start : at + part.stop] = unit
                    rows.append(row)
                rows[-1][:p] += pull @ structure.spread[RIPPLE]
            at += len(c)
    for i, name in enumerate(("delay_x_s", "delay_y_s")):
        if structure.spread[DELAYS.start + i].any():
            names.append(name)
            values.append(theta[DELAYS][i])
            rows.append(np.pad(structure.spread[DELAYS.start + i], (0, design.unknowns - p)))
    return names, np.array(values), np.array(rows)


def _polar(c: np.ndarray) -> tuple[float, tuple[np.ndarray, np.ndarray]]:
    """Size of a complex number given as (Re, Im), and derivatives of size and angle (degrees) by both."""
    size = max(float(np.hypot(c[0], c[1])), 1e-150)
    return size, (np.array([c[0], c[1]]) / size, np.degrees(1.0) * np.array([-c[1], c[0]]) / size**2)


def determined(
    drive: Excitation, names: list[str], values: np.ndarray, covariance: np.ndarray, gains: tuple[float, float]
) -> tuple[list[int], list[str]]:
    """Return the indices of the values that the passage determines, and a message for each other value.

    Args:
        drive: drive of the passage.
        names, values, covariance: reported values.
        gains: gain of χ² by the response to the imbalance in sensors x and y, in units of the residuals' noise. Since
            the frequency was searched, the gain must exceed the best of many trials of noise, one for each frequency
            that the duration of the record resolves.
    """
    chances = max(1.0, (drive.top_rad_s - drive.low_rad_s) * (drive.end_s - drive.start_s) / (2 * np.pi))
    needed = 2 * np.log(chances / _FALSE_ALARM_RATE)
    value = dict(zip(names, values, strict=True))
    std = dict(zip(names, np.sqrt(np.diag(covariance)), strict=True))
    left_out: set[str] = set()
    warnings: list[str] = []
    for i in (1, 2):
        omega, zeta = 2 * np.pi * value[f"f{i}_Hz"], value[f"zeta{i}"]
        precise = std[f"f{i}_Hz"] < 0.03 * value[f"f{i}_Hz"] and std[f"zeta{i}"] < 0.5 * zeta
        passed = drive.low_rad_s <= omega * (1 + zeta) and omega <= drive.top_rad_s * (1 + zeta)
        axis = "xy"[i - 1]
        if not (precise and passed and gains[i - 1] > needed):
            left_out |= {f"f{i}_Hz", f"zeta{i}", f"amplitude_{axis}_m", f"phase_{axis}_deg", f"delay_{axis}_s"}
            warnings.append(
                f"resonance {i} (sensor {axis}) is not identifiable: "
                + (
                    f"the speed goes from {drive.low_rad_s * TO_RPM:.0f} to {drive.top_rad_s * TO_RPM:.0f} rpm "
                    "and does not pass it; record a passage that does"
                    if gains[i - 1] > needed
                    else f"the best one found gains χ² {gains[i - 1]:.3g}, chance alone up to {needed:.3g}; does the "
                    "speed pass it, is the sensor aimed at the disk, is the imbalance large enough?"
                )
            )
    if {"f1_Hz", "f2_Hz"} <= left_out:
        raise NotIdentifiable(f"the record determines neither resonance: {'; '.join(warnings)}")
    if std["axis_angle_deg"] == 0.0:  # left out of the model
        left_out.add("axis_angle_deg")
    elif std["axis_angle_deg"] > 0.5 * np.degrees(AXIS_PRIOR_STD):
        left_out.add("axis_angle_deg")
        warnings.append("axes not resolved: both directions are too similar to determine their angle to the sensors")
    return [i for i, n in enumerate(names) if n not in left_out], warnings


def either(
    names: list[str],
    one: tuple[np.ndarray, np.ndarray],
    instead: tuple[list[str], np.ndarray, np.ndarray],
    probability: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of values over two possible models. Values that the other model lacks are unchanged.

    Args:
        names: names of the values.
        one: values and covariance of the chosen model.
        instead: names, values and covariance of the other model.
        probability: probability of the other model.
    """
    values, covariance = one
    there = [instead[0].index(name) if name in instead[0] else -1 for name in names]
    has = np.array(there) >= 0
    off, own = np.zeros(len(names)), covariance.copy()
    off[has] = instead[1][there][has] - values[has]
    turned = np.array([name.endswith("_deg") for name in names])
    off[turned] = (off[turned] + 180.0) % 360.0 - 180.0
    own[np.ix_(has, has)] = instead[2][np.ix_(there, there)][np.ix_(has, has)]
    mixed = (1 - probability) * covariance + probability * own
    return values + probability * off, mixed + probability * (1 - probability) * np.outer(off, off)


def slow_roll_sentences(names: list[str], values: np.ndarray, covariance: np.ndarray) -> list[str]:
    """Messages about run-out and bow; empty if the model has neither."""
    value, std = dict(zip(names, values, strict=True)), dict(zip(names, np.sqrt(np.diag(covariance)), strict=True))

    def shown(kind: str) -> str:
        sizes = [(axis, f"{kind}_{axis}_m", f"{kind}_{axis}_deg") for axis in "xy"]
        return ", ".join(
            f"{1e6 * value[size]:.4g} ± {1e6 * std[size]:.1g} µm at {value[angle]:.1f}° by sensor {axis}"
            for axis, size, angle in sizes
        )

    messages: list[str] = []
    if "run_out_x_m" in value:
        messages.append(
            f"run-out: the sensors show {shown('run_out')} that turn with the shaft at any speed; it is fitted with "
            "the resonances, and is part of what the sensors are predicted to show"
        )
    if "bow_x_m" in value:
        messages.append(
            f"bow: the springs' rest position turns with the shaft, {shown('bow')}; its force is fitted with the "
            "imbalance's, and acts where points are predicted"
        )
    if "growing_x_m" in value:
        messages.append(
            f"a motion that grows with the square of the speed: {shown('growing')} at the fastest speed, besides the "
            "response to the imbalance. Pendulums locked at different heights tilt the disk, or a laser's stand moves; "
            "it is fitted with the resonances, and predictions of points do not contain it"
        )
    return messages
