"""The key that a store signs with: made on first use, readable by its owner alone, never part of a version."""

import hmac
import os
import secrets
from hashlib import sha256
from pathlib import Path

from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
    load_pem_private_key,
    load_pem_public_key,
)

from pipeline.errors import DatasetError, StoreError
from pipeline.files import sync_folder

FILE = "keys/redaction.pem"
"""Relative to the store's root: PKCS 8, Ed25519, mode 0600."""


def store_key(store: Path) -> Ed25519PrivateKey:
    """The key of a store; it is made where there is none, and two processes that make it at once get the same.

    Raises:
        StoreError: others may read it, it is damaged, or the disk refuses it.
    """
    path = store / FILE
    try:
        if not path.exists():
            _make(path)
        if path.stat().st_mode & 0o077:
            raise StoreError("others may read the key that this store signs with", where=path,
                             mend=f"chmod 600 {path}; if somebody may have read it, delete it and redact again")
        key = load_pem_private_key(path.read_bytes(), None)
    except (ValueError, UnsupportedAlgorithm) as error:
        raise StoreError("the key that this store signs with is damaged", where=path,
                         mend=f"put the file back from a copy, or delete it and redact again: rm {path}") from error
    except OSError as error:
        raise StoreError(f"the key that this store signs with: {error.strerror}", where=path,
                         mend="give the store to whoever runs this") from error
    if not isinstance(key, Ed25519PrivateKey):
        raise StoreError("the key that this store signs with is no Ed25519 key", where=path,
                         mend=f"delete it and redact again: rm {path}")
    return key


def _make(path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    part = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    data = Ed25519PrivateKey.generate().private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    handle = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        if not _linked(part, path) and not path.exists():
            part.rename(path)
    finally:
        part.unlink(missing_ok=True)
    sync_folder(path.parent)


def _linked(part: Path, path: Path) -> bool:
    """Give the file its name unless somebody was first; False where links are impossible."""
    try:
        os.link(part, path)
    except FileExistsError:
        return True
    except OSError:
        return False
    return True


def public_pem(key: Ed25519PrivateKey) -> str:
    """The public half, as it lies beside a statement."""
    return key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo).decode()


def fingerprint(pem: str) -> str:
    """The first 16 digits of the sha256 of a public key, by which people compare keys."""
    return sha256(_public(pem, "a public key").public_bytes(Encoding.Raw, PublicFormat.Raw)).hexdigest()[:16]


def verify(pem: str, signature: str, data: bytes, where: object) -> None:
    """Return when a signature is of these bytes by this key.

    Raises:
        DatasetError: it is not, or the key or signature cannot be read.
    """
    try:
        _public(pem, where).verify(bytes.fromhex(signature.strip()), data)
    except (InvalidSignature, ValueError) as error:
        raise DatasetError("the signature is not of this statement by this key", where=where,
                           mend="do not trust the folder; ask whoever gave it for the version again") from error


def _public(pem: str, where: object) -> Ed25519PublicKey:
    try:
        key = load_pem_public_key(pem.encode())
    except (ValueError, UnsupportedAlgorithm) as error:
        raise DatasetError("the public key cannot be read", where=where, mend="ask for the version again") from error
    if not isinstance(key, Ed25519PublicKey):
        raise DatasetError("the public key is no Ed25519 key", where=where, mend="ask for the version again")
    return key


class Blind:
    """Keyed hashes of what was hidden.

    A plain hash of 'operator ada' gives ada away to whoever tries all names. These need the key of the store.
    """

    def __init__(self, key: Ed25519PrivateKey, version: str) -> None:
        raw = key.private_bytes(Encoding.Raw, PrivateFormat.Raw, NoEncryption())
        self._key = hmac.digest(raw, f"hardcase redaction, before, {version}".encode(), "sha256")

    def __call__(self, data: bytes) -> str:
        """HMAC-SHA256 as hex."""
        return hmac.digest(self._key, data, "sha256").hex()
