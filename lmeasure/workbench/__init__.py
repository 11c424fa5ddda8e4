"""The workbench: the commands in a browser on this machine, over a project folder (docs/workbench.md).

Pages collect options, the command line works: every job is the command that the page shows, run as a process of its own, with the same
results. `project` knows the kinds of files; `jobs` runs commands and keeps their output; `forms` makes fields of a command's options;
`guard` lets in only this machine's browser; `pages` and `api` answer; `server` listens.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
