"""Scan of many poses: cut into chunks, done by threads or a cluster, kept between runs; the same bits whichever way.

A `Plan` holds everything a chunk needs as plain arrays, so that it travels to another process or machine; `scan_chunk` is a pure
function of the plan and the chunk's number.
"""

import hashlib
import itertools
import math
import zipfile
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from lmeasure import kernels
from lmeasure.accuracy.readings import Readings, worst_figures
from lmeasure.core import AccuracyError, FloatArray, IntArray, version_of
from lmeasure.io import cluster_client, files, open_regular, processors
from lmeasure.text import message

Progress = Callable[[int, int], None]

STARTS, WAYS = slice(kernels.BODY_START, kernels.BODY_START + 3), slice(kernels.BODY_WAY, kernels.BODY_WAY + 3)
POSES_PER_CHUNK = 1_000_000


def digest_of(arrays: Mapping[str, Any]) -> str:
    """SHA-256 over named arrays, their types and shapes."""
    digest = hashlib.sha256()
    for name, array in arrays.items():
        values = np.ascontiguousarray(array)
        digest.update(f"{name} {values.dtype.str} {values.shape} ".encode())
        digest.update(values.tobytes())
    return digest.hexdigest()


@dataclass(frozen=True)
class Plan:
    """Scanned poses, as arrays; see `kernels.zone.scan` for cables ... bodies. positions (n, 3) [mm]; quaternions (k, 4); order (m,): the
    order of cables in the lanes; for six cables the first three are inverted first; nodes_per_chunk: the size of a chunk."""

    cables: FloatArray
    positions: FloatArray
    quaternions: FloatArray
    variance: FloatArray
    weights: FloatArray
    scales: FloatArray
    factor: FloatArray
    start: FloatArray
    points: FloatArray
    pairs: IntArray
    bodies: FloatArray
    order: IntArray
    nodes_per_chunk: int
    channels: Readings | None = None  # All readings of a rig with encoders, which determine the pose together

    @property
    def six(self) -> bool:
        """Return whether six cables alone determine the pose; then singular poses separate the assembly modes."""
        return self.channels is None and len(self.cables) == kernels.CABLES

    @property
    def chunks(self) -> int:
        """Return how many chunks the positions make."""
        return -(-len(self.positions) // self.nodes_per_chunk)

    def digest(self) -> str:
        """SHA-256 over every array: two plans with the same digest give the same figures."""
        own = {field.name: getattr(self, field.name) for field in fields(self) if field.name != "channels"}
        return digest_of(own if self.channels is None else own | self.channels.arrays())


def chunk_size(orientations: int) -> int:
    """Nodes of a chunk: a whole number of lanes, about `POSES_PER_CHUNK` poses."""
    return kernels.LANES * max(1, POSES_PER_CHUNK // (kernels.LANES * orientations))


def block_order(cables: FloatArray, positions: FloatArray, quaternions: FloatArray) -> IntArray:
    """(m,) order of the cables: of six that in which the first three directions stay farthest from coplanar over a sample of the poses."""
    if len(cables) != kernels.CABLES:
        return np.arange(len(cables))
    some = positions[np.linspace(0, len(positions) - 1, min(len(positions), 200)).astype(np.int64)]
    turns = quaternions[np.linspace(0, len(quaternions) - 1, min(len(quaternions), 5)).astype(np.int64)]
    poses = np.concatenate([np.repeat(some, len(turns), axis=0), np.tile(turns, (len(some), 1))], axis=1)
    directions = kernels.span_rows_of(cables, poses)[:, :, 3:]
    triples = list(itertools.combinations(range(kernels.CABLES), 3))
    directions = np.where(np.isfinite(directions), directions, 0.0)
    volumes = [np.abs(np.linalg.det(directions[:, list(t)])) for t in triples]
    # nearly all poses count, not the one where a cable cannot run
    best = triples[int(np.argmax([np.quantile(v, 0.02) for v in volumes]))]
    return np.array([*best, *(j for j in range(kernels.CABLES) if j not in best)], dtype=np.int64)


def scan_chunk(plan: Plan, number: int) -> tuple[FloatArray, IntArray]:
    """Figures (F, m) and flags (m,) of a chunk's nodes, as `kernels.zone.scan` gives them."""
    return scan_positions(plan, _positions(plan, number))


def _positions(plan: Plan, number: int) -> FloatArray:
    first = number * plan.nodes_per_chunk
    return plan.positions[first : first + plan.nodes_per_chunk]


def scan_positions(plan: Plan, positions: FloatArray) -> tuple[FloatArray, IntArray]:
    """Figures and flags at (m, 3) positions [mm], by the lanes wherever they are sound."""
    if plan.channels is not None:
        around: dict[str, Any] = {"points": plan.points, "pairs": plan.pairs, "bodies": plan.bodies}
        return worst_figures(plan.channels, positions, plan.quaternions, **around)
    count = len(positions)
    padded = np.concatenate([positions, np.repeat(positions[-1:], -count % kernels.tile(count, kernels.LANES), axis=0)])
    turns = Rotation.from_quat(plan.quaternions)
    order, of_tool = plan.order, plan.bodies[None, :, kernels.BODY_OF_TOOL, None] > 0
    rank = np.argsort(order)
    cables, variance, weights = (np.ascontiguousarray(v) for v in (plan.cables[order], plan.variance[order], plan.weights[order] ** 2))
    tool = turned(turns, plan.cables[order, kernels.ATTACHMENT_XYZ]), turned(turns, plan.points)
    bodies = (np.where(of_tool, turned(turns, plan.bodies[:, part]), plan.bodies[None, :, part]) for part in (STARTS, WAYS))
    near, size = (*bodies, plan.bodies, rank[plan.pairs]), float(np.linalg.norm(plan.cables[:, kernels.ATTACHMENT_XYZ], axis=1).max())
    law = variance, weights, max(1e-3, size), _linked(plan, order), turns.as_matrix()
    figures, left = kernels.scan_lanes(cables, np.ascontiguousarray(padded), *tool, *near, *law)
    figures, left = figures[:, :count], left[:count]
    low, high = figures[kernels.DET_LOW].copy(), figures[kernels.DET_HIGH].copy()
    if len(order) == kernels.CABLES and _swaps(order) % 2 == 0:
        # the rows of the lanes are (e ; arm x e): swapping three columns with three changes the sign, and so does an odd order
        figures[kernels.DET_LOW], figures[kernels.DET_HIGH] = -high, -low
    flags = np.zeros(count, np.int64)
    if left.any():
        # pose by pose where the lanes are not sound
        p = plan
        given = (p.quaternions, p.variance, p.weights, p.scales, p.factor, p.start, p.points, p.pairs, p.bodies)
        figures[:, left], flags[left] = kernels.scan(p.cables, np.ascontiguousarray(positions[left]), *given)
    return figures, flags


def _linked(plan: Plan, order: IntArray) -> kernels.Linked | None:
    """Return the lanes' part of the calibration, the cables in the given order; None without one."""
    m, columns = len(order), plan.factor.shape[1]
    if columns == 0:
        return None
    cables, scales, start = np.ascontiguousarray(plan.cables[order]), np.ascontiguousarray(plan.scales[order]), plan.start[None]
    factor = np.ascontiguousarray(plan.factor.reshape(m, kernels.WIDTH, columns)[order])
    roots, begun, both = kernels.roots_by_cable(factor, kernels.length_gradients(cables, start, np.zeros((1, m)), scales)[0])
    blocks, by_block = np.ascontiguousarray(_in_blocks(roots)), np.ascontiguousarray(_in_blocks(both))
    # Python's sine, because NumPy's differs between processors
    angles = [(math.sin(a), math.cos(a), math.sin(b), math.cos(b)) for a, b in cables[:, kernels.ALPHA : kernels.BETA + 1].tolist()]
    return kernels.Linked(
        roots=blocks,
        begun=begun,
        both=by_block,
        in_roots=np.asarray(blocks.any(axis=(-2, -1))),
        in_both=np.asarray(by_block.any(axis=(-2, -1))),
        tied=np.asarray(by_block.any(axis=(2, 3, 4, 5))),
        ranks=blocks.any(axis=(2, 3, 4)).sum(axis=1),
        beyond=np.asarray(blocks[:, :, 1:].any(axis=(1, 2, 3, 4))),
        drums=np.asarray(factor[:, [kernels.BY_SCALE, kernels.BY_TANGENT, kernels.BY_AXIAL, kernels.BY_PITCH]].any(axis=(1, 2))),
        zero=kernels.span_lengths(cables, start)[0],
        scales=scales,
        guides=np.array([(sa * sb, sa * cb, ca, -ca * cb, ca * sb, 0.0) for sa, ca, sb, cb in angles]),
    )


def _in_blocks(matrices: FloatArray) -> FloatArray:
    """(..., BLOCKS, BLOCKS, BLOCK, BLOCK) of (..., LENGTH, LENGTH)."""
    return np.swapaxes(matrices.reshape(*matrices.shape[:-2], kernels.BLOCKS, kernels.BLOCK, kernels.BLOCKS, kernels.BLOCK), -3, -2)


def turned(turns: Rotation, vectors: FloatArray) -> FloatArray:
    """(k, m, 3) of m vectors turned by k rotations."""
    # one sum per component in a fixed order: einsum or matmul may choose another on another machine
    m = turns.as_matrix()[:, None]
    v = vectors[None]
    return np.stack([m[..., c, 0] * v[..., 0] + m[..., c, 1] * v[..., 1] + m[..., c, 2] * v[..., 2] for c in range(3)], axis=-1)


def _swaps(order: IntArray) -> int:
    return sum(int(order[i] > order[j]) for i in range(len(order)) for j in range(i + 1, len(order)))


def run(
    plan: Plan,
    progress: Progress | None = None,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    checkpoint: Path | None = None,
) -> tuple[FloatArray, IntArray]:
    """Return figures (F, n) and flags (n,) of all positions. workers: threads, by default one per core this process may use; scheduler:
    address of a dask scheduler that computes the chunks instead; checkpoint: folder of finished chunks, from which a killed scan continues.
    AccuracyError if the folder belongs to another scan, or the scheduler cannot be reached."""
    kept = None if checkpoint is None else _SavedChunks(checkpoint, plan)
    n = len(plan.positions)
    figures, flags = np.empty((len(kernels.FIGURES), n)), np.empty(n, np.int64)
    missing = []
    for number in range(plan.chunks):
        stored = kept.get(number) if kept else None
        if stored is None:
            missing.append(number)
        else:
            _place(plan, number, stored, figures, flags)
    done = plan.chunks - len(missing)
    results = _cluster(plan, missing, scheduler) if scheduler else _threads(plan, missing, workers)
    for number, result in results:
        _place(plan, number, result, figures, flags)
        if kept:
            kept.put(number, result)
        done += 1
        if progress:
            progress(done, plan.chunks)
    return figures, flags


def _place(plan: Plan, number: int, result: tuple[FloatArray, IntArray], figures: FloatArray, flags: IntArray) -> None:
    first = number * plan.nodes_per_chunk
    last = first + len(result[1])
    figures[:, first:last], flags[first:last] = result


def _threads(plan: Plan, numbers: list[int], workers: int | None) -> Iterator[tuple[int, tuple[FloatArray, IntArray]]]:
    """Chunks as threads finish them in order; the kernels hold no lock."""
    count = workers or processors()
    if count == 1 or len(numbers) <= 1:
        for number in numbers:
            yield number, scan_chunk(plan, number)
        return
    with ThreadPoolExecutor(count) as pool:
        try:
            yield from zip(numbers, pool.map(lambda number: scan_chunk(plan, number), numbers), strict=True)
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def _cluster(plan: Plan, numbers: list[int], scheduler: str) -> Iterator[tuple[int, tuple[FloatArray, IntArray]]]:
    """Chunks as the workers of a dask cluster finish them; a chunk whose worker dies is done again by another."""
    with cluster_client(scheduler) as client:
        # each task carries its own nodes: nothing is lost with a worker that could not be sent again
        key = plan.digest()[:16]
        futures = [
            client.submit(_numbered_chunk, replace(plan, positions=_positions(plan, number)), number, key=f"zone-{key}-{number}", retries=3)
            for number in numbers
        ]
        for future in import_module("distributed").as_completed(futures, loop=client.loop):
            result = future.result()
            future.release()  # the workers need not keep it any longer
            yield result


def _numbered_chunk(part: Plan, number: int) -> tuple[int, tuple[FloatArray, IntArray]]:
    # received arrays are read-only, and the kernels would be compiled again for them
    arrays: dict[str, Any] = {
        field.name: value.copy() for field in fields(part) if isinstance(value := getattr(part, field.name), np.ndarray)
    }
    own = replace(part, **arrays, channels=None if part.channels is None else part.channels.copied())
    return number, scan_positions(own, own.positions)


class _SavedChunks:
    """Finished chunks in a folder that belongs to one plan."""

    def __init__(self, folder: Path, plan: Plan) -> None:
        self.folder = Path(folder)
        mark = self.folder / "plan.sha256"
        plan_and_program = f"{plan.digest()} lmeasure {version_of('lmeasure')}"
        if mark.exists():
            if files.read_bytes(mark).decode("ascii", "replace").strip() != plan_and_program:
                raise AccuracyError(message("error.holds_the_chunks_of", where=folder))
        else:
            files.write_text(mark, plan_and_program + "\n")

    def get(self, number: int) -> tuple[FloatArray, IntArray] | None:
        """The chunk, or None when it was not finished."""
        path = self._path(number)
        if not path.exists():
            return None
        try:
            with open_regular(path) as file, np.load(file, allow_pickle=False) as stored:
                return stored["figures"], stored["flags"]
        except (OSError, EOFError, ValueError, KeyError, zipfile.BadZipFile) as error:
            said = " ".join(str(error).split()) or type(error).__name__
            raise AccuracyError(message("error.is_no_chunk_of", where=path, error=said)) from error

    def put(self, number: int, result: tuple[FloatArray, IntArray]) -> None:
        """Keep a chunk, whole or not at all."""
        with files.whole(self._path(number)) as temporary:
            np.savez(temporary, figures=result[0], flags=result[1])

    def _path(self, number: int) -> Path:
        return self.folder / f"chunk-{number:06d}.npz"
