"""A calibration in the formats of others, beside `calibration.yaml` (docs/formats.md, "Exports").

One module per format. What a format cannot hold is left out with a reason; what it loses is said in the file.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from truewrench.io.exports import ati, broadcaster, gravity_compensation, matrix_text, npz
from truewrench.io.exports.loss import Loss
from truewrench.model.calibration import Calibration
from truewrench.model.errors import InputError
from truewrench.model.files import atomic_output

_NO_INVERSE = "the gain has no inverse"


@dataclass(frozen=True, slots=True)
class Exports:
    """What was written beside a calibration.

    Attributes:
        written: the files.
        left_out: files that were not written, by name, and why.
        loss: of files that cannot hold the whole gain, by name: what is lost against it.
    """

    written: tuple[Path, ...]
    left_out: Mapping[str, str]
    loss: Mapping[str, Loss]


@dataclass(frozen=True, slots=True)
class _Format:
    """Name of a file, how it is written, why (not), and what it loses."""

    name: str
    write: Callable[[Calibration, Path], None]
    unfit: Callable[[Calibration], str | None] = lambda calibration: None
    loss: Callable[[Calibration], Loss] | None = None
    needs_inverse: bool = True


_FORMATS = (
    _Format("matrix.txt", matrix_text.write),
    _Format("calibration.npz", npz.write, needs_inverse=False),
    _Format("calibration.cal", ati.write, ati.unfit),
    _Format("force_torque_sensor_broadcaster.yaml", broadcaster.write, broadcaster.unfit, broadcaster.loss),
    _Format(
        "ft_calib_data.yaml",
        gravity_compensation.write,
        gravity_compensation.unfit,
        gravity_compensation.loss,
    ),
)


def write_exports(calibration: Calibration, folder: str | Path) -> Exports:
    """Write a calibration in every format that can hold it.

    A file of an earlier calibration that cannot be written anew is removed: it would be taken for this one's.
    """
    written: list[Path] = []
    left_out: dict[str, str] = {}
    loss: dict[str, Loss] = {}
    for format_ in _FORMATS:
        path = Path(folder) / format_.name
        if format_.needs_inverse and not np.isfinite(calibration.inverse).all():
            reason: str | None = _NO_INVERSE
        else:
            reason = format_.unfit(calibration)
        if reason is None:
            try:
                with atomic_output(path) as temporary:
                    format_.write(calibration, temporary)
            except InputError as error:  # calibration.yaml stands: the command has not failed
                reason = str(error)
            except OSError as error:
                reason = f"it cannot be written: {error.strerror}"
        if reason is None:
            written.append(path)
            if format_.loss is not None:
                loss[format_.name] = format_.loss(calibration)
            continue
        left_out[format_.name] = reason
        if path.is_file():
            path.unlink()
    return Exports(tuple(written), left_out, loss)
