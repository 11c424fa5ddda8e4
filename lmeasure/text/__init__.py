"""Texts in the reader's language: messages by code, their catalogues, and the words of pages."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
