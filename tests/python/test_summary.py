"""A person reads the verdict first, and no digit that means nothing."""

from __future__ import annotations

import io
from dataclasses import replace

import pytest
from rich.console import Console

from truewrench.model.calibration import Assumed, Calibration, Verdict
from truewrench.report.summary import calibration_summary, show, with_uncertainty


@pytest.mark.parametrize(
    ("value", "std", "text"),
    [
        (1.002343, 0.00043, "1.00234 ± 0.00043"),
        (1.002345, 0.0196, "1.002 ± 0.020"),
        (-0.5, 12.0, "0 ± 12"),
        (1234.5, 123.0, "1234 ± 123"),
        (2.5e-7, 1e-9, "2.5000e-07 ± 1.0e-09"),
        (3.0e9, 1e6, "3.0000e+09 ± 1.0e+06"),
        (2.0, 0.0, "2 ± 0"),
    ],
)
def test_digits_are_those_that_the_uncertainty_deserves(value: float, std: float, text: str) -> None:
    assert with_uncertainty(value, std) == text


def printed(calibration: Calibration, width: int = 80) -> str:
    sink = io.StringIO()
    show(Console(file=sink, width=width, highlight=False), calibration_summary(calibration))
    return sink.getvalue()


def test_verdict_comes_first_in_words(calibration: Calibration) -> None:
    assert printed(calibration).startswith("USABLE")
    verdict = Verdict(usable=False, reasons=("3 of 10 windows were rejected", "not converged"))
    lines = printed(replace(calibration, verdict=verdict)).splitlines()
    assert lines[0] == "NOT TO BE USED AS IT STANDS"
    assert lines[1:3] == ["  - 3 of 10 windows were rejected", "  - not converged"]


def test_undetermined_directions_are_named(calibration: Calibration) -> None:
    assert "The data do not determine:\n  - moment about z: gain of fz" in printed(calibration)


def test_every_gain_stands_in_eighty_columns(calibration: Calibration) -> None:
    text = printed(calibration)
    for row, deviations in zip(calibration.gain, calibration.gain_std, strict=True):
        for gain, std in zip(row, deviations, strict=True):
            assert with_uncertainty(gain, std) in text


def test_gain_that_the_data_do_not_determine_stands_in_brackets(calibration: Calibration) -> None:
    assert "brackets" not in printed(calibration)
    std = calibration.gain_std.copy()
    std[4, 2] = 1e3
    text = printed(replace(calibration, gain_std=std))
    assert f"({with_uncertainty(calibration.gain[4, 2], 1e3)})" in text
    assert f"({with_uncertainty(calibration.gain[4, 1], std[4, 1])})" not in text
    assert "In brackets: not determined by the data" in text


def test_what_was_assumed_and_what_could_not_be_seen_stand_below_the_verdict(
    calibration: Calibration,
) -> None:
    text = printed(replace(calibration, axes={**calibration.axes, "mz": False}), 120)
    assert "Axes that may not be used: mz." in text
    assert (
        "Assumed beside the rig as stated:\n"
        "  - noise, factor on the stated, all logs: 2.50 ± 0.10 (residuals)\n"
        "  - step of the offset, fraction of range, run.csv, fx, 3.2 s: 0.01\n"
    ) in text
    assert "What this record could not have shown:\n  - a delay of 1 ms would move a gain by 0.4 %\n" in text
    verdict = replace(calibration.verdict, blind_to=())
    plain = printed(replace(calibration, verdict=verdict, assumed=(), axes={}), 120)
    assert not any(words in plain for words in ("Assumed", "could not have shown", "may not be used"))


def test_long_lists_of_assumptions_are_cut(calibration: Calibration) -> None:
    many = tuple(Assumed("step", f"{k} s", 0.01) for k in range(9))
    text = printed(replace(calibration, assumed=many))
    assert "  - step, 4 s: 0.01\n  - and 4 more, in calibration.yaml\n" in text


def test_notes_are_no_reasons(calibration: Calibration) -> None:
    text = printed(replace(calibration, figures={"notes": ["column wz is constant (0)"]}))
    assert text.startswith("USABLE")
    assert "Note: column wz is constant (0)" in text


def test_names_from_files_are_printed_as_they_are(calibration: Calibration) -> None:
    verdict = Verdict(usable=False, reasons=("channel [bold]fx[/bold] :smile:",))
    assert "channel [bold]fx[/bold] :smile:" in printed(replace(calibration, verdict=verdict))
