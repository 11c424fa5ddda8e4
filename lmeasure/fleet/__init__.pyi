from .catalogue import Catalogue as Catalogue, Outcome as Outcome
from .items import Item as Item, read_items as read_items
from .store import Store as Store, StoreError as StoreError, digest_of as digest_of
from .workers import LostError as LostError, outcomes as outcomes
