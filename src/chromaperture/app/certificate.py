"""What the app's address needs to stay the same from run to run: a token, and a certificate for other machines.

Browsers give a page the camera, and let it be installed, only over https or on the machine itself. No authority signs
certificates for addresses of a home network, so the server signs its own; a phone has to be told once to trust it.
"""

from __future__ import annotations

import datetime
import ipaddress
import os
import re
import socket
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from chromaperture.app.gate import new_token
from chromaperture.system.errors import InputError, needed
from chromaperture.system.storage import staged

_DAYS = 397  # the longest that Safari accepts, https://support.apple.com/en-us/102028
_RENEW_DAYS = 30  # before the end; chosen by hand
_TOKEN = re.compile(r"[A-Za-z0-9_-]{20,64}")
NEEDS_EXTRA = "the app needs the extra: pip install 'chromaperture[serve]'"


@dataclass(frozen=True)
class Certificate:
    """Files of a certificate and its key, and the SHA-256 by which a phone's owner can compare it."""

    certificate: Path
    key: Path
    fingerprint: str


def state_folder() -> Path:
    """Return where tokens and keys are kept: ``$CHROMAPERTURE_STATE``, else the system's place for such files."""
    given = os.environ.get("CHROMAPERTURE_STATE")
    if given:
        return Path(given)
    if os.name == "nt":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local") / "chromaperture"
    return Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state") / "chromaperture"


def kept_token(folder: Path, *, anew: bool = False) -> str:
    """Return the token of this user's app, or draw another one, which closes the app to the old address."""
    path = folder / "serve.token"
    if not anew and path.is_file():
        token = path.read_text(encoding="ascii", errors="replace").strip()
        if _TOKEN.fullmatch(token):
            return token
    token = new_token()
    with staged(folder) as stage:
        _private_text(stage.path(path.name), token + "\n")
    return token


def kept_certificate(folder: Path, names: list[str]) -> Certificate:
    """Return this machine's certificate for names and addresses, made where it lacks one or ends soon."""
    x509 = needed("cryptography.x509", NEEDS_EXTRA)
    paths = folder / "serve.crt", folder / "serve.key"
    if all(path.is_file() for path in paths):
        try:
            known = x509.load_pem_x509_certificate(paths[0].read_bytes())
        except ValueError:
            known = None
        if known is not None and _serves(known, names):
            return Certificate(*paths, _fingerprint(known))
    made, key = _make(names)
    from cryptography.hazmat.primitives import serialization

    with staged(folder) as stage:
        private = key.private_bytes(
            serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
        )
        _private_text(stage.path(paths[1].name), private.decode())
        stage.path(paths[0].name).write_bytes(made.public_bytes(serialization.Encoding.PEM))
    return Certificate(*paths, _fingerprint(made))


def own_names() -> list[str]:
    """Return this machine's names and addresses in its network, the address that a phone would use first."""
    name = socket.gethostname()
    found = []
    for family, far in ((socket.AF_INET, "192.0.2.1"), (socket.AF_INET6, "2001:db8::1")):  # RFC 5737, RFC 3849
        with socket.socket(family, socket.SOCK_DGRAM) as probe:  # connecting a datagram socket sends nothing
            try:
                probe.connect((far, 9))
                found.append(probe.getsockname()[0])
            except OSError:
                continue
    return list(dict.fromkeys([*found, name, f"{name}.local", "localhost", "127.0.0.1", "::1"]))


def qr_code(address: str) -> str:
    """Draw an address as a QR code in characters for a terminal; raises MissingDependencyError."""
    import io

    out = io.StringIO()
    needed("segno", NEEDS_EXTRA).make(address, error="m").terminal(out=out, compact=True)
    return out.getvalue()


def _make(names: list[str]) -> tuple[Any, Any]:
    """Make a certificate that is its own authority, which phones ask for; returns it and its key."""
    from cryptography.hazmat.primitives import hashes
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

    x509, key = needed("cryptography.x509", NEEDS_EXTRA), ec.generate_private_key(ec.SECP256R1())
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "chromaperture app on this computer")])
    now = datetime.datetime.now(datetime.UTC)
    usage = {
        "digital_signature": True, "key_cert_sign": True, "crl_sign": False, "content_commitment": False,
        "key_encipherment": False, "data_encipherment": False, "key_agreement": False, "encipher_only": False,
        "decipher_only": False,
    }  # fmt: skip
    builder = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - datetime.timedelta(hours=1))  # clocks of phones differ
        .not_valid_after(now + datetime.timedelta(days=_DAYS))
        .add_extension(x509.SubjectAlternativeName([_general(x509, name) for name in names]), critical=False)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(x509.KeyUsage(**usage), critical=True)
        .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), critical=False)
    )
    return builder.sign(key, hashes.SHA256()), key


def _general(x509: Any, name: str) -> Any:
    try:
        return x509.IPAddress(ipaddress.ip_address(name))
    except ValueError:
        return x509.DNSName(name)


def _serves(certificate: Any, names: list[str]) -> bool:
    """Whether a certificate holds all names and does not end soon."""
    x509 = needed("cryptography.x509", NEEDS_EXTRA)
    try:
        found = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return False
    has = {str(value) for kind in (x509.DNSName, x509.IPAddress) for value in found.get_values_for_type(kind)}
    left = certificate.not_valid_after_utc - datetime.datetime.now(datetime.UTC)
    return left.days >= _RENEW_DAYS and {str(_plain(name)) for name in names} <= has


def _plain(name: str) -> str:
    try:
        return str(ipaddress.ip_address(name))
    except ValueError:
        return name


def _fingerprint(certificate: Any) -> str:
    from cryptography.hazmat.primitives import hashes

    return ":".join(f"{byte:02X}" for byte in certificate.fingerprint(hashes.SHA256()))


def _private_text(path: Path, text: str) -> None:
    """Write a file that only its owner can read."""
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except OSError as error:
        raise InputError(f"cannot write {path} ({error.strerror}); set CHROMAPERTURE_STATE to another folder") from None
    with os.fdopen(descriptor, "w", encoding="ascii") as file:
        file.write(text)
