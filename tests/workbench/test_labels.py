"""What options and files are called on the pages of the workbench, in each language."""

import re
from pathlib import Path

from lmeasure import workbench
from lmeasure.report import blocks
from lmeasure.text import texts
from lmeasure.workbench import forms
from lmeasure.workbench.project import _BY_SCHEMA, Project
from lmeasure.workbench.text import said
from lmeasure.workflows import COMMANDS, load, options_of

HERE = Path(workbench.__file__).parent


def test_every_option_has_a_label_and_a_help_in_each_language() -> None:
    for name in COMMANDS:
        for option in options_of(load(name).settings):
            assert option.label.code, f"{name}: add label.{option.name} to the catalogues"
            assert option.label.text("ru") != option.label.text("en"), option.label.code
            assert option.help.code in texts("ru"), f"{name}: {option.name}"


def test_every_kind_of_file_has_a_name_on_pages() -> None:
    kinds = set(_BY_SCHEMA.values()) | set(re.findall(r'Found\("([\w ]+)"', (HERE / "project.py").read_text(encoding="utf-8")))
    assert {f"workbench.kind.{kind.replace(' ', '_')}" for kind in kinds} <= set(texts("en"))


def test_help_names_other_options_as_the_page_does() -> None:
    fields = {f.option.name: f for f in forms.fields("zone", Project(Path()))}
    assert (
        fields["o"]
        .help_text(lambda text, **v: said("en", text, **v))
        .startswith("Angle O of the thesis [deg], with “Angle A” and “Angle T”")
    )
    assert "«Угол A»" in fields["o"].help_text(lambda text, **v: said("ru", text, **v))
    assert fields["limit_deg"].help_text(lambda text, **v: said("ru", text, **v)).endswith("От 0 до 90.")
    for name in COMMANDS:
        if name in forms.NOT_HERE:
            continue
        for field in forms.fields(name, Project(Path())):
            for language in ("en", "ru"):
                reported = field.help_text(lambda text, language=language, **v: said(language, text, **v))
                assert not reported.startswith("--")
                assert "`" not in reported


def test_columns_of_a_result_keep_their_names() -> None:
    """The names of columns may leave out the first; a line without columns ends a table."""
    lines = [
        "after this number of poses:",
        "          rms    worst  cable",
        "   2   1.8349   6.4803  c2",
        "   3   0.2434   1.5676  c2",
        "the end",
    ]
    table = [["", "rms", "worst", "cable"], ["2", "1.8349", "6.4803", "c2"], ["3", "0.2434", "1.5676", "c2"]]
    assert blocks(lines) == [[["after this number of poses:"]], table, [["the end"]]]
