"""Commands for many folders: the items, a store of their results, and workers for them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
