"""Lines that commands print, English as workflows make them, in the words of a Russian terminal."""

import json
import re
from pathlib import Path

import pytest

from lmeasure.accuracy import REASONS
from lmeasure.acquisition.logs.registry import FORMATS
from lmeasure.cli.app import main
from lmeasure.cli.text import as_typed, marked, retold
from lmeasure.io import FILE_KINDS
from lmeasure.text import Say
from lmeasure.workflows.schema import Settings, run

SAID = [
    (
        "drive.trc.gz: 10766 frames in 15.3712 s; PEAK's TRC, packed, times of day",
        "drive.trc.gz: кадров 10766 за 15,3712 с; TRC фирмы PEAK, сжат, время суток",
    ),
    ("      080  can0         1538     100.0/s      0 bytes", "      080  can0         1538     100,0/с      0 байт"),
    ("    13     0.0023     0.0063  c2         44 of 48  further", "    13     0,0023     0,0063  c2         44 из 48  сверх плана"),
    ("            rms      worst  cable    determined", "            СКЗ     худшая  трос     определено"),
    (
        "goes rx -12.0 to 3.1 deg, x -110.7 to 110.7 mm, z -15.1 to 48.6 mm",
        "ходы rx от -12,0 до 3,1°, x от -110,7 до 110,7 мм, z от -15,1 до 48,6 мм",
    ),
    (
        "effect radius of B1: 0.12 mm  u 0.1  p 0.2  3.1 bits learned: not found",
        "эффект radius, B1: 0,12 мм  u 0,1  p 0,2  узнано бит 3,1: не найден",
    ),
    (
        "rejected nodes by reason: pressure angle 54, near singular 2",
        "отвергнуто узлов по причинам: угол давления 54, близость к особой позе 2",
    ),
    ("the 95 % radius covers counts of +-1/2", "в радиус 95 % входят дискретность отсчётов ±1/2"),
    (
        "workspace: 0.376 litres, 47 places of 80; x from -40 to 40 mm; ended by reach of the legs (14), limits of joints (3)",
        "рабочая область: 0,376 л, точек 47 из 80; x от -40 до 40 мм; граница: досягаемость (14), пределы координат (3)",
    ),
    (
        "warning underdetermined: B1: 19 equations leave 3 of 3 unknowns undetermined; there the nominal rig's priors decide "
        "(0.3892 mm rms of the predicted lengths)",
        "предупреждение underdetermined: B1: уравнений 19, из 3 неизвестных не определены 3; там решают априорные значения "
        "номинальной установки (0,3892 мм СКЗ предсказанных длин)",
    ),
    (
        "warning effect: what is left of the residuals follows the law of another pulley radius of ch6 (29 mm): p = 1.9e-05 for "
        "chance, with 32 effects tried; nothing was corrected",
        "предупреждение effect: остаток невязок следует закону: другой радиус шкива, ch6 (29 мм); p = 1,9·10⁻⁵ для случайности, "
        "испытано эффектов: 32; ничего не исправлено",
    ),
    (
        "B1              26.0177    1.075e+07   5 of 8     < 1e-9  has moved",
        "B1              26,0177    1,075e+07   5 из 8     < 1e-9  сместилось",
    ),
    (
        "compared with cal: nothing moved beyond the uncertainties (probability of chance under 0.01)",
        "сравнение с cal: смещений больше неопределённостей нет (вероятность случайности меньше 0,01)",
    ),
    ("2000 samples: 1990 ok, 6 gap, 4 jump", "замеров 2000: 1990 с позой, пропусков 6, скачков 4"),
    ("    15.0 s  2131 samples (142/s)  14931 frames  latency 9.8 ms", "    15,0 с  замеров 2131 (142/с)  кадров 14931  задержка 9,8 мс"),
    (
        "pose: (+1.250, -2.000, +3.000) mm within 0.020 (95 %)  quaternion (+0.0, +0.0, +0.0, +1.0)  worst pressure angle 34 deg  "
        "frame to pose 3.1 ms",
        "поза: (+1,250; -2,000; +3,000) мм в пределах 0,020 (95 %)  кватернион (+0,0; +0,0; +0,0; +1,0)  худший угол давления 34°  "
        "от кадра до позы 3,1 мс",
    ),
    ("2000 samples: 1990 ok, 10 origin_lost", "замеров 2000: 1990 с позой, 10 начало отсчёта потеряно (origin_lost)"),
    (
        "taken as exact, not stated; usual sizes would add up to, in mm: friction (a band of 8 counts) 0.093, temperature (5 K since "
        "zeroing) 0.15",
        "принято точным, не указано; обычные значения добавили бы до, в мм: трение (зона в 8 отсч.) 0,093, температура (5 К после "
        "обнуления) 0,15",
    ),
    (
        "a rest, but not at pose 5: off what is expected: c4 by +575.4 mm (u 0.39), c1 by +409.3 mm (u 0.58); Enter reads it all the same",
        "покой, но не в позе 5: не то, что ожидалось: c4 на +575,4 мм (u 0,39), c1 на +409,3 мм (u 0,58); Enter всё равно считает",
    ),
    (
        "  2 of at least 7 poses: too few yet to determine anything by counts alone",
        "  поз 2 из не менее чем 7: по одним отсчётам пока ничего не определить",
    ),
    (
        "counts are missing: ch4 in 120, ch5 in 3 of 177 samples; look at the encoder, its plug and its cable",
        "отсчётов нет: ch4 в 120, ch5 в 3 из 177 замеров; осмотрите датчик, его разъём и кабель",
    ),
    (
        "Cable c4: channel ch5 moved, the rig says ch4; counts down when paid out, the rig says count_sign = 1; came back -100.00 mm from "
        "where it was: slack, or it slips on the drum. Type r to do it again, or go on",
        "Трос c4: сдвинулся канал ch5, а в файле установки ch4; при сматывании отсчёты убывают, а в файле установки count_sign = 1; "
        "вернулся с отличием -100,00 мм: слабина, или он проскальзывает на барабане. Введите r, чтобы повторить, или продолжайте",
    ),
    (
        "inclination tilt_x: counts up, the rig says count_sign = -1. Type r to do it again, or go on",
        "наклон tilt_x: отсчёты растут, а в файле установки count_sign = -1. Введите r, чтобы повторить, или продолжайте",
    ),
    ("pose 1  no counts     - - -", "поза 1  нет отсчётов     - - -"),
    (
        "distance  P2 to P3       +1.5000 mm  U95 0.0419  p 0.02  off",
        "расстояние  P2 до P3       +1,5000 мм  U95 0,0419  p 0,02  не сходится",
    ),
    (
        "run/pass1.log: 2800 frames in 2.015 s; lines of candump -L, times of day",
        "run/pass1.log: кадров 2800 за 2,015 с; строки candump -L, время суток",
    ),
    ("      181  can0          404     200.3/s      4 bytes", "      181  can0          404     200,3/с      4 байт"),
    (
        "my cell/demo.rrd is shown at http://127.0.0.1:9090/ by any browser of this machine, and of no other; Ctrl-C ends it",
        "my cell/demo.rrd показывается по адресу http://127.0.0.1:9090/ любым браузером этой машины, и никакой другой; завершает Ctrl-C",
    ),
    (
        "my cell/rig.toml: three drums, each hooked to another tool point in a second pass of the same motion: for robots that "
        "repeat their motion",
        "my cell/rig.toml: три барабана, во втором проходе того же движения каждый зацеплен за другую точку инструмента: для роботов, "
        "которые повторяют движение",
    ),
    (
        "effect radius of B3: 41.2 mm  u 6.3  p 5.6e-11  0.7 bits learned: found",
        "эффект radius, B3: 41,2 мм  u 6,3  p 5,6e-11  узнано бит 0,7: найден",
    ),
    (
        "2000 samples, window +-0.02 s: path 925.941 mm, speed up to 859.588 mm/s; no uncertainty is stated: state it by columns or "
        "--u-position-mm",
        "замеров 2000, окно ±0,02 с: путь 925,941 мм, скорость до 859,588 мм/с; неопределённость не указана: укажите её столбцами или "
        "--u-position-mm",
    ),
    (
        "note: the orientation is not measured, or not under known names (qx, qy, qz and qw, or the angles of a controller): nothing is "
        "said of rotations",
        "примечание: ориентация не измерена или не под известными именами (qx, qy, qz и qw или углы контроллера): о поворотах ничего не "
        "сказано",
    ),
    (
        "note: no robot moves at 860 m/s: places or times are in other units than stated",
        "примечание: роботы не движутся со скоростью 860 м/с: места или времена в других единицах, чем указано",
    ),
    (
        "first that is not ok: sample 1000 at 1 s, cable c3: channel ch3 stepped by about +299 counts (within 20) between 0.999 and 1 s: "
        "its origin is lost",
        "первый с ошибкой: замер 1000 при 1 с, трос c3: канал ch3: скачок примерно на +299 отсч. (не точнее 20) между 0,999 и 1 с, начало "
        "отсчёта потеряно",
    ),
    (
        "first that is not ok: sample 0 at 0 s: the cables contradict each other, and no single one explains it",
        "первый с ошибкой: замер 0 при 0 с: тросы противоречат друг другу, и ни один в отдельности этого не объясняет",
    ),
    (
        "first that is not ok: sample 3 at 0.3 s, cable c1, c2: channel ch3 was elsewhere for a moment",
        "первый с ошибкой: замер 3 при 0,3 с, трос c1, c2: канал ch3: мгновенный выброс",
    ),
    (
        "note: smallest fault that a single sample tells apart from one of any other channel (significance 0.1 %, power 80 %), where it "
        "shows best and worst: c1 0.084 to 7.1 mm, c8 0.054 to 22 mm",
        "примечание: наименьшая ошибка, которую отдельный отсчёт отличает от ошибки любого другого канала (значимость 0,1 %, мощность "
        "80 %), там, где она видна лучше и хуже всего: c1 от 0,084 до 7,1 мм, c8 от 0,054 до 22 мм",
    ),
    (
        "path line 1: led around, at most 130.9 mm from the command, ends kept",
        "траектория line 1: обведена, не дальше 130,9 мм от заданной, концы сохранены",
    ),
    (
        "path round: LEFT AS IT IS: sample 1, an end, is beyond a limit itself: pressure angle of c1",
        "траектория round: ОСТАВЛЕНА КАК БЫЛА: точка 1, конец, сама за пределом: угол давления троса c1",
    ),
    (
        "12 poses of 1500 candidates; left uncertain of their places, rms, at 0.05 mm a coordinate:",
        "поз 12 из 1500 кандидатов; остаётся неопределённость их мест, СКЗ, при 0,05 мм на координату:",
    ),
    ("  after  10: 2.6166 mm, at random 2.9856", "  после  10: 2,6166 мм, при случайном выборе 2,9856"),
    (
        "note: no tool is stated (--tool): the target is taken to sit on the flange itself, where it tells nothing of the last joint",
        "примечание: инструмент не указан (--tool): считается, что мишень стоит на самом фланце, где о последнем шарнире она ничего не "
        "говорит",
    ),
    (
        "left as it was: pick.dat:2: XP1: the frame BASE_DATA[2] is not stated",
        "оставлено как было: pick.dat:2: XP1: система координат BASE_DATA[2] не указана",
    ),
    (
        "left as it was: pick.src:5: LIN XP1: is not declared here with its values",
        "оставлено как было: pick.src:5: LIN XP1: здесь не объявлена со значениями",
    ),
    ("left as it was: a.csv:2: T0: a cell that is no number", "оставлено как было: a.csv:2: T0: ячейка, которая не число"),
    (
        "left as it was: m.mod:7: p1: an external axis is at 10: where robot and workpiece then are is not known",
        "оставлено как было: m.mod:7: p1: внешняя ось стоит на 10: где тогда робот и деталь, неизвестно",
    ),
    (
        "left as it was: t.csv:2: T0: a singular pose lies between the nominal and the corrected joint values: another branch",
        "оставлено как было: t.csv:2: T0: между номинальными и исправленными значениями шарниров лежит особая поза: другая ветвь",
    ),
    ("c1: -12.5 to 20.1 mm", "c1: от -12,5 до 20,1 мм"),
    ("Largest U95 of the position (radius): not stated", "Наибольшая U95 положения (радиус): не указана"),
    (
        "largest correction 2.990 mm; the identified robot was off by up to 2.991 mm",
        "наибольшая поправка 2,990 мм; идентифицированный робот отстоял на величину до 2,991 мм",
    ),
    ("U95 of where it goes now: 0.205 mm at most", "U95 того, куда он идёт теперь: не больше 0,205 мм"),
    ("U95 of where it goes now: cannot be told", "U95 того, куда он идёт теперь: сказать нельзя"),
    (
        "left as it was: prog.script:3: movej of line 3: a correction of 2.642 mm and 0.696°; 0.1 mm and 1° are the most",
        "оставлено как было: prog.script:3: movej строки 3: поправка 2,642 мм и 0,696°; предел 0,1 мм и 1°",
    ),
    ("gradient (omega; v): 2253060, 1.23129·10⁷, -1030830, -959.368", "градиент (ω; v): 2253060; 1,23129·10⁷; -1030830; -959,368"),
    (
        "warning unmatched: pose 'P12' stands in my/robot.csv alone; it is left out",
        "предупреждение unmatched: поза 'P12' есть только в my/robot.csv; она не учтена",
    ),
    ("one robot over time, serial number 0001: old, new", "один робот в разное время, заводской номер 0001: old, new"),
    ("3 robots of one type, R-6: a, b, c", "роботов 3 одного типа, R-6: a, b, c"),
    ("2 robots: a, b", "роботов 2: a, b"),
    ("  mean of P1: 0.120 mm (U95 0.014), chance 0.0012  moved", "  среднее P1: 0,120 мм (U95 0,014), случайность 0,0012  сместилось"),
    (
        "  AP_p of P1 at 50 %: 0.10 -> 0.22 mm, difference +0.12 (U95 0.01)",
        "  AP_p в P1 at 50 %: 0,10 -> 0,22 мм, разность +0,12 (U95 0,01)",
    ),
    ("note: new: certified with other settings: rule, align", "примечание: new: сертифицировано с другими настройками: rule, align"),
    ("  sw1: 0.00343 deg, 0.00764 deg; 0.00385 mm", "  sw1: 0,00343°, 0,00764°; 0,00385 мм"),
    ("  c2: 0.126 mm, 2.01 mm; 0.0616 mm", "  c2: 0,126 мм, 2,01 мм; 0,0616 мм"),
    ("  c3: 0.126 mm, none; 0.0616 mm", "  c3: 0,126 мм, нет; 0,0616 мм"),
    ("  c4: none, none; none", "  c4: нет, нет; нет"),
    (
        "figures differ in their last digits, by 1.1e-09 at most; up to 1e-06 is no difference",
        "величины различаются в последних знаках, не более чем на 1,1e-09; до 1e-06 это не различие",
    ),
    (
        "note: a frame was fitted in some: what moved the whole robot or instrument is not seen",
        "примечание: в некоторых подобрана система координат: общее смещение робота или прибора не видно",
    ),
]


@pytest.fixture
def russian(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LANGUAGE", "ru")


@pytest.mark.usefixtures("russian")
@pytest.mark.parametrize(("line", "told"), SAID)
def test_a_line_is_told_in_russian(line: str, told: str) -> None:
    assert retold(line) == told


@pytest.mark.usefixtures("russian")
def test_the_list_of_schemas_keeps_its_names_and_columns() -> None:
    for line, name in zip(run(Settings()).summary, FILE_KINDS, strict=True):
        told = retold(line)
        assert told[:27] == line[:27] == f"{name:<10} {FILE_KINDS[name].file:<15} "
        assert not re.search("[A-Za-z]{3}", told[27:])


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("up to 2.5 mm, 3 of 4; -12.0 to 3.1°", "up to 2,5 mm, 3 of 4; -12,0 to 3,1°"),
        ("at (79.8, 2.7, 245) mm; P1, P2, 3", "at (79,8; 2,7; 245) mm; P1, P2, 3"),
        ("0.3 bits: 0.5 %, 1.9e-05; ±0.02 s, [0.0625].", "0,3 bits: 0,5 %, 1,9e-05; ±0,02 s, [0,0625]."),
    ],
)
def test_numbers_of_a_line_have_its_decimal_mark(line: str, told: str) -> None:
    assert marked(line, ",") == told


@pytest.mark.parametrize(
    "line",
    [
        "--x -437.5:437.5:125 --u-mm 0.5",
        "u_position_mm = 0.5, position_mm = [0.5, 1.5]",
        "out/p-1.5.json, v0.5.2/a.csv, cell.1.5.toml",
        "udp_multicast:239.74.163.2, http://127.0.0.1:9090",
        "`lmeasure zone --limit-deg 60.5` or 'a 0.5'",
        "7.2.1; thesis-5.5",
        "поза 3 (4 из 20): x -12.5  y 100.2  z 35.0  oz 12.75",
    ],
)
def test_what_may_be_typed_or_pasted_again_keeps_its_point(line: str) -> None:
    assert marked(line, ",") == line


@pytest.mark.usefixtures("russian")
@pytest.mark.parametrize("reason", REASONS)
def test_what_alone_keeps_all_out_of_a_zone_is_told(reason: str) -> None:
    told = retold(f"nothing of the box is in the zone: 3420 nodes are kept out by {reason.replace('_', ' ')} alone")
    assert not re.search("[A-Za-z]", told), told


@pytest.mark.usefixtures("russian")
@pytest.mark.parametrize(
    ("of", "fault"),
    [
        ("cable c4: ", "came back -100.00 mm from where it was: slack, or it slips on the drum"),
        ("cable c4: ", "no channel moved by 20 mm, but sw1 moved by 45 degrees"),
        ("cable c4: ", "6000 counts in a turn, the rig says 3000: 2 times as many, as a counter decoded at another scale"),
        ("swivel of B1: ", "no swivel turned by 5 degrees, but ch3 moved by 50 mm"),
        ("swivel of B1: ", "channel sw2 turned, the rig says sw1"),
        ("swivel of B1: ", "sw2, sw3 turned with it"),
        ("swivel of B1: ", "came back +1.20 degrees from where it was: loose on its shaft, or the cable does not take it along"),
        (
            "swivel of B1: ",
            "turned by 20 degrees with counts_per_revolution = 131072; if it was by about 45, a revolution has about 5.8e+04 counts",
        ),
        ("inclination tx: ", "no inclination turned by 2 degrees"),
        ("inclination tx: ", "counts down, the rig says count_sign = 1"),
        ("", "200 SYNCs for 100 frames of a counter: more than one sends the SYNC, such as another recording"),
        ("", "channel ch2: 322 frames 182h for 161 SYNCs: more than one device sends them"),
        ("", "1F5h (33 frames) from a sender that the rig does not name"),
        ("", "channel ch4: moves by 10 counts at rest"),
        ("", "channel ch1 moves with 2 cables"),
    ],
)
def test_what_a_check_finds_is_told(of: str, fault: str) -> None:
    told = retold(f"fault: {of}{fault}")
    assert told.startswith("неисправность: ")
    own = {*re.findall("[A-Za-z]{2,}", f"{of.split()[-1] if of else ''} counts_per_revolution count_sign SYNC"), "ch", "sw"}
    assert not {*re.findall("[A-Za-z]{2,}", told)} - own, told


@pytest.mark.usefixtures("russian")
def test_every_fault_that_the_docs_list_is_told() -> None:
    page = (Path(__file__).parents[2] / "docs" / "acquisition.md").read_text(encoding="utf-8")
    table = page.partition("| kind |")[2].partition("\n\n")[0]
    kinds = [kind for row in table.splitlines()[2:] for kind in re.findall("`([a-z_]+)`", row.split("|")[1])]
    assert len(kinds) > 15
    for kind in kinds:
        told = retold(f"10 samples from 20 frames over 1.000 s: 3 {kind}").partition(": ")[2]
        assert re.search("[а-я]{4}", told), told
        assert told.split("(")[0].strip().endswith("3"), told


@pytest.mark.usefixtures("russian")
@pytest.mark.parametrize("dialect", [one.label for one in FORMATS])
def test_kinds_of_logs_are_told(dialect: str) -> None:
    assert retold(dialect) != dialect


@pytest.mark.usefixtures("russian")
def test_where_a_recording_is_shown_is_told(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """By the command itself, while it serves."""
    monkeypatch.setattr(
        "lmeasure.view.web.serve", lambda path, port, say: say(f"from another machine: ssh -L {port}, then the same address there")
    )
    monkeypatch.setattr("sys.argv", ["lmeasure", "view", "a.rrd", "--web"])
    with pytest.raises(SystemExit):
        main()
    assert capsys.readouterr().out == "с другой машины: ssh -L 9090, затем там тот же адрес\n"


@pytest.mark.parametrize(
    ("words", "told", "in_russian"),
    [
        (
            "zone rig.toml --out z.nc --limit-deg 0,5",
            "'--limit-deg': must be a number, is '0,5'; a number has a point",
            "должно быть числом",
        ),
        ("plan-poses rig.toml --out p.csv --poses 3.5", "'--poses': must be a whole number, is '3.5'", "целым числом, а задано '3.5'"),
        ("plan-poses rig.toml --out p.csv --poses 0", "'--poses': must be at least 1, is '0'", "не меньше 1, а задано '0'"),
        ("zone rig.toml --out z.nc --tilt-steps 0", "'--tilt-steps': must be at least 1, is '0'", "не меньше 1, а задано '0'"),
        (
            "plan-poses rig.toml --poses 3 --out p.csv --tilt-deg 91",
            "'--tilt-deg': must be at most 90, is '91'",
            "не больше 90, а задано '91'",
        ),
    ],
)
def test_a_number_that_cannot_be_taken_is_refused_in_plain_words(
    words: str, told: str, in_russian: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def error(*more: str) -> tuple[str, str]:
        monkeypatch.setattr("sys.argv", ["lmeasure", *words.split(), *more])
        with pytest.raises(SystemExit) as ended:
            main()
        assert ended.value.code == 2
        return capsys.readouterr()

    assert f"Invalid value for {told}" in error()[1]
    assert json.loads(error("--json")[0])["error"] == f"Invalid value for {told}"
    monkeypatch.setenv("LANGUAGE", "ru")
    assert in_russian in error()[1]


@pytest.mark.usefixtures("russian")
def test_what_was_typed_wrongly_keeps_its_point() -> None:
    assert "0.5" in as_typed("Invalid value for '--limit-deg': 100.5 is not in the range 0.5<=x<=90.")
    assert as_typed("No such option: --usr (Possible options: --rig, --start)") == "Нет параметра --usr. Возможно, один из: --rig, --start"


def test_signs_are_those_that_people_write() -> None:
    assert retold("1.5 +- 0.2 mm/s2") == "1.5 ± 0.2 mm/s²"


@pytest.mark.parametrize(
    "last", ["the zero phase", "the start pose", "an unknown start", "the zeros of encoders", "the passes", "restored origins"]
)
def test_what_uncertainties_cover_is_told_whatever_comes_last(last: str) -> None:
    for end in (": the rig links no calibration", ""):
        told = Say("ru").message(f"counts of half a unit, the passes and {last}{end}")
        assert "дискретность отсчётов, проходы и " in told
        assert not re.search("[a-z]", told), told
