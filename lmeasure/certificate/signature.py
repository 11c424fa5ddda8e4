"""Ed25519 signatures (RFC 8032) of a manifest, by a key of the user's, checked without a network."""

import base64
import binascii
import contextlib
import hashlib
import json
import math
import os
from pathlib import Path
from typing import Any

from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from lmeasure.core import CertificationError, KeyKeptError, LMeasureError
from lmeasure.io import files
from lmeasure.text import message


def canonical(value: Any) -> bytes:
    """The value as JSON in UTF-8; doubles as the shortest text that reads back to the same one, at most 17 digits.

    CertificationError names the place of a number that is not finite.
    """
    try:
        text = json.dumps(value, indent=1, ensure_ascii=False, allow_nan=False)
    except ValueError:
        _only_finite(value, "")
        raise
    return f"{text}\n".encode("utf-8", "backslashreplace")


def digest(value: Any) -> str:
    """SHA-256 of the canonical text, hexadecimal."""
    return hashlib.sha256(canonical(value)).hexdigest()


def _only_finite(value: Any, where: str) -> None:
    if isinstance(value, dict):
        for key, inner in value.items():
            _only_finite(inner, f"{where}.{key}" if where else str(key))
    elif isinstance(value, list | tuple):
        for i, inner in enumerate(value):
            _only_finite(inner, f"{where}[{i}]")
    elif isinstance(value, float) and not math.isfinite(value):
        raise CertificationError(message("error.is_not_a_finite", where=where, value=value))


SCHEMA = "lmeasure.signature/1"
_RAW = serialization.Encoding.Raw, serialization.PublicFormat.Raw


def new_key(path: Path, *, force: bool = False) -> str:
    """Write a new private key (PKCS 8, PEM, readable by its owner only) and `path` + .pub; return the fingerprint of the public key.

    KeyKeptError when either file exists and force is not given: a key that signed something must not be lost.

    The private key is on the disk before the public one. Killed in between, there is a private key alone, never two of different pairs.
    """
    path = Path(path)
    public_path = path.with_name(path.name + ".pub")
    for taken in (path, public_path):
        if taken.exists() and not force:
            raise KeyKeptError(message("error.exists_force_replaces_the_key", where=taken))
    key = Ed25519PrivateKey.generate()
    private = key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    public = key.public_key().public_bytes(serialization.Encoding.PEM, serialization.PublicFormat.SubjectPublicKeyInfo)

    def put(one: Path, content: bytes) -> None:
        with files.whole(one) as temporary:
            _write_private(temporary, content) if one == path else temporary.write_bytes(content)

    before = {one: files.read_bytes(one) for one in (public_path, path) if one.exists()}
    try:
        with files.whole(public_path) as public_temporary:
            public_temporary.write_bytes(public)
            public_path.unlink(missing_ok=True)
            put(path, private)
    except LMeasureError:  # half a pair is no key; the old pair is as it was
        for one in (public_path, path):
            with contextlib.suppress(OSError, LMeasureError):
                if one not in before:
                    one.unlink(missing_ok=True)
                elif not one.exists() or one.read_bytes() != before[one]:
                    put(one, before[one])
        raise
    return fingerprint(key.public_key())


def _write_private(path: Path, content: bytes) -> None:
    """Write a file that only its owner can read."""
    path.unlink(missing_ok=True)
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o600), "wb") as file:
        file.write(content)


def fingerprint(key: Ed25519PublicKey) -> str:
    """SHA-256 of the raw public key, hexadecimal."""
    return hashlib.sha256(key.public_bytes(*_RAW)).hexdigest()


def read_private_key(path: Path) -> Ed25519PrivateKey:
    """An unencrypted Ed25519 private key in PEM; CertificationError when it is something else."""
    text = files.read_bytes(path)
    try:
        key = serialization.load_pem_private_key(text, password=None)
    except (ValueError, TypeError, UnsupportedAlgorithm) as error:
        why = message("error.key_with_password" if isinstance(error, TypeError) else "error.key_not_in_pem")
        raise CertificationError(message("error.a_key_of_its", where=path, why=why)) from None
    if not isinstance(key, Ed25519PrivateKey):
        raise CertificationError(message("error.is_not_an_ed25519", where=path))
    return key


def read_public_key(path: Path) -> Ed25519PublicKey:
    """An Ed25519 public key in PEM; CertificationError when it is something else."""
    text = files.read_bytes(path)
    try:
        key = serialization.load_pem_public_key(text)
    except (ValueError, UnsupportedAlgorithm):
        raise CertificationError(message("error.is_not_a_public", where=path)) from None
    if not isinstance(key, Ed25519PublicKey):
        raise CertificationError(message("error.is_not_an_ed25519_public", where=path))
    return key


def sign(content: bytes, key: Ed25519PrivateKey) -> dict[str, Any]:
    """The table of signature.json for the bytes of a manifest."""
    return _table(key.public_key(), key.sign(content))


def _table(key: Ed25519PublicKey, signature: bytes) -> dict[str, Any]:
    return {
        "schema": SCHEMA,
        "algorithm": "Ed25519",
        "signed": "manifest.json",
        "public_key": base64.b64encode(key.public_bytes(*_RAW)).decode("ascii"),
        "signature": base64.b64encode(signature).decode("ascii"),
    }


def signer(content: bytes, table: bytes) -> Ed25519PublicKey:
    """Return the public key whose signature of the content is in the bytes of signature.json; CertificationError names the fault.

    Every byte counts: the file must be written in the form of `sign`.
    """
    try:
        stated = json.loads(table)
        key = Ed25519PublicKey.from_public_bytes(base64.b64decode(stated["public_key"], validate=True))
        signature = base64.b64decode(stated["signature"], validate=True)
        key.verify(signature, content)
    except InvalidSignature:
        raise CertificationError(message("error.the_signature_is_not")) from None
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError, binascii.Error):
        raise CertificationError(message("error.cannot_be_read_as_a")) from None
    if canonical(_table(key, signature)) != table:
        raise CertificationError(message("error.is_not_written_as"))
    return key
