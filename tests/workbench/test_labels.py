"""What options are called: a label for each, none for nothing, in both languages; and all words of the pages in Russian."""

import re
from pathlib import Path

from lmeasure import workbench
from lmeasure.text import texts
from lmeasure.workbench import api, cards, details, forms, pages, rig_form, tour
from lmeasure.workbench.project import _BY_SCHEMA, Project
from lmeasure.workbench.text import said
from lmeasure.workflows import COMMANDS, load, options_of
from lmeasure.workflows.options import COMMON_LABELS

HERE = Path(workbench.__file__).parent
SPOKEN = re.compile(r"""_\(\s*(?:"([^"]+)"|'([^']+)')""")


LABELS = {option.label for name in COMMANDS for option in options_of(load(name).settings)}


def test_a_label_is_of_words_and_a_common_one_is_of_several_commands() -> None:
    assert not [label for label in LABELS if "_" in label]
    for name, label in COMMON_LABELS.items():
        commands = [c for c in COMMANDS if any((o.name, o.label) == (name, label) for o in options_of(load(c).settings))]
        assert len(commands) > 1, f"state {label!r} with the option {name} of {commands}"


def test_labels_and_words_of_pages_are_said_in_russian() -> None:
    known = {**texts("labels", "ru"), **texts("workbench", "ru"), **texts("cli", "ru")}
    assert set(texts("labels", "ru")) == LABELS
    spoken = LABELS | set(pages.STEP_NAMES.values()) | set(cards.TITLES.values()) | set(cards.VERBS.values())
    spoken |= {text for page in cards.PAGES.values() for text in (page.title, page.lead)}
    spoken |= {text for _, text in cards.NEEDS.values()} | {text for ways in cards.ONWARD.values() for _, text in ways}
    spoken |= set(details.FORM) | {entry.label for entry in details.ENTRIES if entry.label}
    spoken |= {stop.text for stop in tour.STOPS} | set(rig_form.HELP.values()) | set(rig_form.NAMES.values()) | set(rig_form.DRAWN)
    spoken |= set(_BY_SCHEMA.values()) | set(re.findall(r'Found\("([\w ]+)"', (HERE / "project.py").read_text(encoding="utf-8")))
    spoken |= {verb["summary"] for ways in api.described()["paths"].values() for verb in ways.values() if "summary" in verb}
    for template in (HERE / "templates").glob("*.html"):
        spoken |= {a or b for a, b in SPOKEN.findall(template.read_text(encoding="utf-8"))}
    assert sorted(spoken - set(known)) == [], "add them to lmeasure/text/locale/ru/workbench.po"


def test_help_names_other_options_as_the_page_does() -> None:
    fields = {f.option.name: f for f in forms.fields("zone", Project(Path()))}
    assert fields["o"].told(lambda text, **v: said("en", text, **v)).startswith("Angle O of the thesis [deg], with “Angle A” and “Angle T”")
    assert "«Угол A»" in fields["o"].told(lambda text, **v: said("ru", text, **v))
    assert fields["limit_deg"].told(lambda text, **v: said("ru", text, **v)).endswith("От 0 до 90.")
    for name in COMMANDS:
        if name in forms.NOT_HERE:
            continue
        for field in forms.fields(name, Project(Path())):
            for language in ("en", "ru"):
                told = field.told(lambda text, language=language, **v: said(language, text, **v))
                assert not told.startswith("--")
                assert "`" not in told
