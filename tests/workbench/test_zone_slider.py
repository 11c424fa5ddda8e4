"""The page Zone and place: the zone of the slider is the zone of the command."""

import re
from pathlib import Path

import pytest
import xarray as xr
from bench import client
from browser import opened
from in_process import ran

from lmeasure.rig import write_rig
from lmeasure.simulation import cell_rig

GRID = ("--x=-400:400:100", "--y=-400:400:100", "--z=-200:200:100")


def zone(*words: str) -> xr.Dataset:
    """What the command writes."""
    ran("zone", "rig.toml", *GRID, *words)
    with xr.open_dataset(words[words.index("--out") + 1], engine="h5netcdf") as read:
        return read.load()


def test_the_volume_of_the_u95_slider_is_that_of_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_rig(tmp_path / "rig.toml", cell_rig(0))
    zone("--out", "zones/zone.nc", "--report", "zones/page")
    with client(tmp_path) as session:
        page = session.get("/zone").text
        address = re.search(r'src="(/shown/\w+/zones/page/zone.html)#sliders"', page)
        assert address is not None
        assert "/run/program?zone=zones/zone.nc" in page
        shown = session.get(address[1])
    assert "sandbox" in shown.headers["content-security-policy"]
    with opened(tmp_path / "zones" / "page" / "zone.html") as browser:
        browser.wait("document.getElementById('left').textContent !== ''")
        for place in (350, 700):
            browser.evaluate(
                f"(() => {{const e = document.getElementById('u95'); e.value = {place}; e.dispatchEvent(new Event('input'))}})()"
            )
            limit, left = browser.evaluate("['u95-reported', 'left'].map(name => document.getElementById(name).textContent)")
            reported = zone("--out", f"zones/{place}.nc", "--u95-mm", limit.removesuffix("\u00a0mm"))
            nodes = int(reported.attrs["nodes_in_zone"])
            assert 0 < nodes < reported["in_zone"].size
            assert f" {nodes} of " in left
            volume = re.search(r"([\d.]+) m³", left)
            assert volume is not None, left
            assert float(volume[1]) == float(f"{reported.attrs['zone_volume_mm3'] / 1e9:.3g}")
