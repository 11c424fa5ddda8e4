"""Many folders at once: what items there are, a store of their results, and workers that do them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
