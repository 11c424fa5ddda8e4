from .catalogue import (
    Catalogue as Catalogue,
    Item as Item,
    LostError as LostError,
    Outcome as Outcome,
    Store as Store,
    StoreError as StoreError,
    digest_of as digest_of,
    outcomes as outcomes,
    read_items as read_items,
)
