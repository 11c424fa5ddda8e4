"""Notes and reasons of the computation, which come in English: those it writes often, with the same groups in each translation; {n0} is the
group {0} where that is a number."""

import re

from lmeasure.report.words import number

SENTENCES: dict[str, list[tuple[str, str]]] = {
    "en": [],
    "ru": [
        (
            r"(the resolution of the counts.*); not the calibration: the rig links none",
            r"{0}; кроме калибровки: описание установки на неё не ссылается",
        ),
        (r"the resolution of the counts", r"дискретность отсчётов"),
        (r"the resolution of the counts, (.*)", r"дискретность отсчётов, {0}"),
        (
            r"(calibration|zero phase|start pose|(?:clock|place) of pass \d+|temperature, stretch and sag|dimensions as stated|"
            r"run-out of drums|eccentric pulleys|play of drums|closure of the counts), (.*)",
            r"{0}, {1}",
        ),
        (r"dimensions as stated", r"размеры в заявленных пределах"),
        (r"play of drums", r"люфт барабанов"),
        (r"taken as exact, not stated: (.*); (.*) would add up to (.*) mm", r"принято точным, не заявлено: {0}; {1} дало бы до {n2} мм"),
        (r"count length", r"длина троса на отсчёт"),
        (r"groove pitch", r"шаг канавки"),
        (r"run-out of drums", r"биение барабанов"),
        (r"eccentric pulleys", r"эксцентриситет шкивов"),
        (r"attachment points", r"точки крепления"),
        (r"backlash", r"люфт"),
        (r"friction", r"трение"),
        (r"temperature", r"температура"),
        (r"(\d\.\d+) mm", r"{n0} мм"),
        (r"(\d\.\d+) %", r"{n0} %"),
        (r"a band of (\d+) counts", r"зона в {0} отсчётов"),
        (r"(\d+) K since zeroing", r"{0} К после обнуления"),
        (r"(\d+) K since zeroing, calibrated at (.*) deg C", r"{0} К после обнуления (калибровка при {n1} °C)"),
        (
            r"no expansion is stated, and it was up to (.*) K off the (?:calibration|rig)'s (.*) deg C: steel would add up to (.*) mm",
            r"тепловое расширение не заявлено, а температура отличалась до {n0} К от {n1} °C: для стали это дало бы до {n2} мм",
        ),
        (r"calibration", r"калибровка установки"),
        (r"zero phase", r"фаза обнуления счётчиков"),
        (r"start pose", r"начальная поза"),
        (r"clock of pass (\d+)", r"часы прохода {0}"),
        (r"place of pass (\d+)", r"положение в проходе {0}"),
        (r"temperature, stretch and sag", r"температура, растяжение и провисание тросов"),
        (r"closure of the counts", r"незамыкание отсчётов"),
        (
            r"channel (.*) \(cable (.*)\) stepped by (.*) counts \((.*) mm\) between (.*) and (.*) s",
            r"канал {0} (трос {1}): скачок на {n2} отсч. ({n3} мм) между {n4} и {n5} с",
        ),
        (r"counts suspected lost: (.*)", r"возможна потеря отсчётов: {0}"),
        (
            r"suspected: (.*); poses after that hang on it, and get no verdict",
            r"возможна потеря отсчётов: {0}; позы после этого зависят от неё и остаются без заключения",
        ),
        (
            r"channel (.*) does not close: (.*) counts \((.*) mm\) between two rests at one place, which enter the uncertainties as lost "
            r"at a moment that is not known",
            r"канал {0} не замыкается: {n1} отсч. ({n2} мм) между двумя остановками в одном месте; в неопределённостях учтены как "
            r"потерянные в неизвестный момент",
        ),
        (
            r"back at the first place of rest the counts differ by (.*): the robot moved, or several channels lost counts",
            r"по возвращении к первому месту остановки отсчёты отличаются на {0}: сместился робот либо несколько каналов потеряли отсчёты",
        ),
        (
            r"steps of a counter by (.*) counts \((.*) mm\) and more are seen, the acceleration of the motion itself, (.*) mm/s2, being "
            r"the limit",
            r"скачки счётчика от {n0} отсч. ({n1} мм) обнаруживаются; предел – ускорение самого движения, {n2} мм/с²",
        ),
        (
            r"(steps of a counter .*); it is sampled too slowly for its speed to show smaller ones",
            r"{0}; для меньших запись при такой скорости слишком редка",
        ),
        (
            r"steps of counters are not seen: no channel has four counts on end",
            r"скачки счётчиков не видны: ни в одном канале нет четырёх отсчётов подряд",
        ),
        (r"(steps of a counter .*); of (.*), without four counts on end, none are", r"{0}; в {1}, без четырёх отсчётов подряд, не видны"),
        (
            r"no redundancy, (\d+) cables for (\d+) unknowns: what is wrong from the beginning or errs slowly is never seen: .*",
            r"избыточности нет, тросов {0} на {1} неизвестных: неверное с самого начала или медленное не обнаруживается: перепутанные "
            r"каналы, знак, масштаб, запаздывающий канал, повисший трос, отсчёты, теряемые понемногу",
        ),
        (
            r"one cable to spare, (\d+) cables for (\d+) unknowns: that lengths contradict each other is seen, but not which of them is "
            r"wrong",
            r"избыточен один трос, тросов {0} на {1} неизвестных: противоречие длин обнаруживается, но не то, какая неверна",
        ),
        (
            r"(\d+) cables to spare, (\d+) cables for (\d+) unknowns: one that contradicts the others is seen and left out",
            r"избыточных тросов {0}, тросов {1} на {2} неизвестных: противоречащий остальным обнаруживается и исключается",
        ),
        (
            r"channel (.*) stepped by about (.*) counts \(within (.*)\) between (.*) and (.*) s: its origin is lost",
            r"канал {0}: скачок примерно на {n1} отсч. (не точнее {n2}) между {n3} и {n4} с, начало отсчёта потеряно",
        ),
        (
            r"channel (.*) stood up to (.*) s and counts again: its origin is lost",
            r"канал {0} стоял до {n1} с и снова считает, начало отсчёта потеряно",
        ),
        (
            r"channel (.*) does not follow the tool between (.*) and (.*) s, which goes on evenly: its origin is lost",
            r"канал {0} не следует за инструментом между {n1} и {n2} с, начало отсчёта потеряно",
        ),
        (r"(.*: its origin is lost), and it errs again at (.*) s", r"{0}, до следующей ошибки в {n1} с"),
        (
            r"(channel .*); but it is back where it was at the rest at (.*) s: it has lost nothing",
            r"{0}; но на остановке в {n1} с он на прежнем месте: ничего не потеряно",
        ),
        (r"(channel .*); but the other cables show that it has lost nothing", r"{0}; но остальные тросы показывают: ничего не потеряно"),
        (
            r"channel (.*) stands from (.*) s on while its point is drawn far: it does not count",
            r"канал {0} стоит с {n1} с, хотя его точка далеко перемещается: он не считает",
        ),
        (r"channel (.*) was elsewhere for a moment behind (.*) s", r"канал {0}: мгновенный выброс после {n1} с"),
        (
            r"channel (.*) was elsewhere for a moment, (\d+) times, first behind (.*) s",
            r"канал {0}: мгновенные выбросы, всего {1}, первый после {n2} с",
        ),
        (r"all channels step as if the clock had, behind (.*) s", r"скачок во всех каналах, как от часов, после {n0} с"),
        (
            r"all channels step as if the clock had, behind (.*) s and at (\d+) more instants",
            r"скачки во всех каналах, как от часов, после {n0} с и ещё {1}",
        ),
        (
            r"from (.*) to (.*): cable (.*) does not follow the other cables, by up to (.*) mm \(standard uncertainty (.*) mm\), and is "
            r"left out",
            r"от {0} до {1}: трос {2} не согласуется с остальными, до {n3} мм (стандартная неопределённость {n4} мм), и исключён",
        ),
        (
            r"from (.*) to (.*): cable (.*) does not follow the other cables, and is left out",
            r"от {0} до {1}: трос {2} не согласуется с остальными и исключён",
        ),
        (
            r"from (.*) to (.*): the cables contradict each other, and which is wrong cannot be told",
            r"от {0} до {1}: тросы противоречат друг другу, какой из них неверен, неизвестно",
        ),
        (
            r"from (.*) to (.*): the cables contradict each other, and no single one explains it",
            r"от {0} до {1}: тросы противоречат друг другу, и ни один в отдельности этого не объясняет",
        ),
        (
            r"from (.*) to (.*): the cables contradict each other: (.*) is wrong, and which cannot be told",
            r"от {0} до {1}: тросы противоречат друг другу, неверен один из: {2}",
        ),
        (r"the beginning", r"начала"),
        (r"the end", r"конца"),
        (r"([-\d.e+]+) s", r"{n0} с"),
        (
            r"the rig links no calibration: by how much its drawing is off is in no uncertainty, and makes lengths contradict each other "
            r"as well; `lmeasure calibrate` finds it",
            r"описание установки не ссылается на калибровку: отклонения от чертежа не входят в неопределённости и тоже приводят к "
            r"противоречию длин; их находит `lmeasure calibrate`",
        ),
        (r"pass (\d+): the recording ended early(.*)", r"проход {0}: запись оборвалась{1}"),
        (r"pass (\d+): faults while it was recorded: (.*)", r"проход {0}: сбои при записи: {1}"),
        (
            r"the uncertainties of the trajectory, systematic ones taken as common to the cycles of a pose or path, random ones so or as "
            r"independent, whichever is worse",
            r"неопределённости траектории: систематические приняты общими для циклов одной позы или траектории, случайные – общими либо "
            r"независимыми, по худшему случаю",
        ),
        (r"worst pressure angle (.*) deg; the zone ends at (.*) deg", r"наибольший угол давления {n0}°; граница зоны {n1}°"),
        (r"U95 of a position (.*) mm; the zone ends at (.*) mm", r"U95 положения {n0} мм; граница зоны {n1} мм"),
        (
            r"pose (.*): angles (.*) are singular at the commanded orientation; (.*) instead",
            r"поза {0}: углы {1} вырождены при заданной ориентации; вместо них {2}",
        ),
        (
            r"pose (.*): angles (.*) are singular at the commanded orientation; no component-wise angles",
            r"поза {0}: углы {1} вырождены при заданной ориентации; углов по составляющим нет",
        ),
        (
            r"pose (.*): its pressure angles are not known, and not held against the zone",
            r"поза {0}: углы давления неизвестны и с зоной не сравнивались",
        ),
        (
            r"path (.*): its pressure angles are not known, and not held against the zone",
            r"траектория {0}: углы давления неизвестны и с зоной не сравнивались",
        ),
        (
            r"no windows stated: (\d+) rests of at least (.*) s within (.*) mm found, the second half of each taken",
            r"интервалы не заданы: найдено остановок {0} не короче {n1} с в пределах {n2} мм, взята вторая половина каждой",
        ),
        (
            r"time stamps jitter, (.*) to (.*) ms apart: the motion shows each in error by (.*) ms \(standard uncertainty\), which "
            r"speeds and times carry",
            r"метки времени дрожат, промежутки от {n0} до {n1} мс: по движению погрешность каждой {n2} мс (стандартная "
            r"неопределённость), она учтена в скоростях и временах",
        ),
        (
            r"time stamps jitter, (.*) to (.*) ms apart: the motion shows samples taken evenly, every (.*) ms, known to (.*) of it and "
            r"each to (.*) ms \(standard uncertainties\); even times are taken, and speeds and times carry it",
            r"метки времени дрожат, промежутки от {n0} до {n1} мс: по движению отсчёты взяты равномерно, через {n2} мс с относительной "
            r"неопределённостью {n3}, каждый до {n4} мс (стандартные неопределённости); взяты равномерные времена, неопределённость учтена "
            r"в скоростях и временах",
        ),
        (
            r"pass (\d+): time stamps jitter, (.*) to (.*) ms apart: the motion shows samples taken evenly, and the passes are brought "
            r"together by even times",
            r"проход {0}: метки времени дрожат, промежутки от {n1} до {n2} мс: по движению отсчёты взяты равномерно, проходы сведены по "
            r"равномерным временам",
        ),
        (
            r"pass (\d+): time stamps jitter, (.*) to (.*) ms apart: the motion shows each in error by (.*) ms, which poses carry",
            r"проход {0}: метки времени дрожат, промежутки от {n1} до {n2} мс: по движению погрешность каждой {n3} мс, она учтена в позах",
        ),
        (r"limit band (.*) mm", r"граничная полоса {n0} мм"),
        (r"limit band (.*) mm, the pose's repeatability", r"граничная полоса {n0} мм – повторяемость позы"),
        (
            r"limit band (.*) mm; from the beginning of the motion, not from the command",
            r"граничная полоса {n0} мм; от начала движения, а не от команды",
        ),
        (r"back within (.*) mm", r"возвращение в пределы {n0} мм"),
        (
            r"pass (\d+) has no sync edges: its clock is taken as pass 1's",
            r"в проходе {0} нет фронтов синхронизации: его часы приняты за часы прохода 1",
        ),
        (
            r"the robot's repeatability between the passes is not in the uncertainties",
            r"повторяемость робота между проходами в неопределённости не входит",
        ),
    ],
}


def sentence(language: str, text: str) -> str | None:
    """A sentence of the computation in the language, None where the table does not have it."""
    for pattern, told in SENTENCES[language]:
        found = re.fullmatch(pattern, text)
        if found is not None:
            parts = found.groups()
            as_numbers = {f"n{i}": number(language, part) for i, part in enumerate(parts)}
            return told.format(*(sentence(language, part) or part for part in parts), **as_numbers)
    return None
