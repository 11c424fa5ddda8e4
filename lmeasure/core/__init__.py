"""Types of arrays, errors, statuses, poses, angle conventions and square roots of covariances: the base of every other package."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
