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
