"""A million mutated frames through the assemblers and the recorder's lines: none may raise, and the output stays in order.

`python benchmarks/fuzz_frames.py [--frames 1000000] [--seed 0]` prints the count and the rate and keeps them in
benchmarks/results/fuzz_frames.md. The suite runs a small part of it.
"""

import argparse
import platform
import resource
import sys
import time
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))

from frame_fuzz import fuzz  # noqa: E402


def main() -> None:
    """Run, print and keep."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    begin = time.perf_counter()
    done = fuzz(asked.frames, asked.seed)
    seconds = time.perf_counter() - begin
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    text = (
        f"# Mutated frames\n\n`python benchmarks/fuzz_frames.py --frames {asked.frames} --seed {asked.seed}`, {platform.machine()}, "
        f"Python {platform.python_version()}.\n\n{done['frames']} frames in {seconds:.0f} s ({done['frames'] / seconds:.0f}/s) gave "
        f"{done['samples']} samples and {done['faults']} faults; no exception, times rising, at most {memory:.0f} MB in memory.\n"
    )
    (HERE / "results" / "fuzz_frames.md").write_text(text)
    print(text)


if __name__ == "__main__":
    main()
