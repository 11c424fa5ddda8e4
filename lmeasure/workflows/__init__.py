"""Each command, once: settings in, result out; command lines, pages and scripts use it.

A workflow `zone` is `ZoneSettings`, a model of its options, and `run_zone(settings, progress)`, which reads, calls the stages, writes
every file, and gives a `Result`. `registry` lists them; none is loaded before it is used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
