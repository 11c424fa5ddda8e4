"""Errors, as one tree.

Every error is one line for the person at the instrument: the file, the sample, the cable and the limit that was broken. The
command line prints it and exits with 1; a script catches `LMeasureError`.
"""

LONGEST_TEXT = 1000


def shortened(text: str) -> str:
    """Return a very long text without its middle: its beginning names the file, its end often the remedy."""
    return text if len(text) <= LONGEST_TEXT else f"{text[: LONGEST_TEXT - 205]} ... {text[-200:]}"


class LMeasureError(Exception):
    """Error of the data or the usage: base class of all exceptions of lmeasure.

    `str(error)` is one line with the cause and the remedy. `lines` has every fault of a file.

    Examples
    --------
    >>> try:
    ...     lm.read_rig(Path("missing.toml"))
    ... except lm.LMeasureError as error:
    ...     print(error)
    missing.toml: cannot be read: No such file or directory
    """

    complaints: tuple[str, ...] = ()
    """One line for each fault of a file; empty for a single fault."""

    def __str__(self) -> str:
        others = len(self.complaints) - 1
        return one_line(super().__str__()) + (f" (and {others} more)" if others > 0 else "")

    @property
    def lines(self) -> tuple[str, ...]:
        """Return all faults, a line each; the first is the text of the error."""
        return tuple(one_line(text) for text in self.complaints) or (str(self),)


def one_line(text: str) -> str:
    """Return a text without line ends and hidden characters, which names of files and texts of other libraries may contain."""
    return shortened("".join(c if c.isprintable() else f"\\u{{{ord(c):X}}}" for c in " ".join(text.split())))


class OverwriteError(LMeasureError):
    """A file that a command would write over is not its own: an input, a recording, another command's output, a person's file. Exit code
    2."""


class SettingsError(LMeasureError):
    """An option that makes no sense: missing, unknown, of another kind, out of its range, or beside another. Exit code 2.

    option is its name in the settings, empty where no single one is wrong; text is the fault without the name.
    """

    def __init__(self, option: str, text: str) -> None:
        super().__init__(f"{option}: {text}" if option else text)
        self.option, self.text = option, text


class CancelledError(LMeasureError):
    """The user has ended the work: raised by a progress callback. No half-written file is left."""

    def __init__(self, text: str = "interrupted. Nothing was left half-written") -> None:
        super().__init__(text)


class FileFormatError(LMeasureError, ValueError):
    """File in a wrong form: missing, not TOML, without a column, with a cell that is no number."""


class RigError(FileFormatError):
    """A rig.toml that contradicts the contract or itself; the text names the key."""


class GeometryError(LMeasureError, ValueError):
    """A cable that cannot exist: an attachment point on the swivel axis or inside the pulley."""


class CalibrationError(LMeasureError, ValueError):
    """Reference poses and counts from which no observation point can be found."""


class TrajectoryError(LMeasureError, ValueError):
    """A run that the screw method cannot start on."""


class AcquisitionError(LMeasureError, OSError):
    """Bus or log without the signals of the rig."""


class RecordedError(OverwriteError, AcquisitionError):
    """A recording is there already: it cannot be made again."""


class AccuracyError(LMeasureError, ValueError):
    """Accuracy zone or placement that cannot be computed with these settings."""


class StructureError(LMeasureError, ValueError):
    """Points and links that are no mechanism, or limits of lengths that cannot be kept."""


class CertificationError(LMeasureError, ValueError):
    """A program and a trajectory from which a characteristic cannot be determined."""


class OtherTrajectoryError(CertificationError):
    """A trajectory is not the one that its run gives."""


class KeyKeptError(OverwriteError, CertificationError):
    """Existing key that must not be replaced: its signatures could not be checked any more."""


class ForeignFolderError(OverwriteError, CertificationError):
    """Folder for a certificate that contains anything but an earlier certificate."""


class RobotError(LMeasureError, ValueError):
    """Robot that cannot carry out its program; `sample` is the place in a path."""

    def __init__(self, text: str, sample: int | None = None) -> None:
        super().__init__(text)
        self.sample = sample


def pasted(path: object) -> str:
    """A path as it can be pasted into a shell, between quotation marks where it has blanks or other marks of shells."""
    import os
    import re
    import shlex

    text = str(path)
    if re.fullmatch(r"[\w@%+=:,./\\-]+", text):
        return text
    return f'"{text}"' if os.name == "nt" else shlex.quote(text)
