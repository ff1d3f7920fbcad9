"""Command-line options of the connection to the broker."""

from __future__ import annotations

import argparse
import os
import ssl
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from woosh_robot_agent.vda5050.mqtt import BrokerConfig

PASSWORD_VARIABLE = "VDA5050_PASSWORD"
"""Environment variable with the password."""


def add_broker_options(parser: argparse.ArgumentParser) -> None:
    """Add `--broker` and the other options of the broker to a parser."""
    group = parser.add_argument_group("broker")
    group.add_argument(
        "--broker",
        required=True,
        metavar="URL",
        help="URL of the broker, e.g. mqtt://192.168.0.2:1883, or mqtts://broker.example for TLS",
    )
    group.add_argument("--username", help="user name at the broker")
    group.add_argument(
        "--password-file",
        type=Path,
        metavar="FILE",
        help="file with the password, in its first line; without it, the environment variable "
        f"{PASSWORD_VARIABLE} is used. A password in the URL can be seen by all users of this "
        "machine",
    )
    group.add_argument(
        "--ca-file",
        type=Path,
        metavar="FILE",
        help="certificates that are trusted to sign the broker's, in PEM (default: those of the "
        "system)",
    )
    group.add_argument("--cert-file", type=Path, metavar="FILE", help="client certificate, in PEM")
    group.add_argument(
        "--key-file",
        type=Path,
        metavar="FILE",
        help="private key of the client certificate, in PEM and not encrypted (default: in "
        "--cert-file)",
    )


def broker_config(
    options: argparse.Namespace, environment: Mapping[str, str] = os.environ
) -> BrokerConfig:
    """Return the configuration of the connection to the broker.

    Args:
        options: options that `add_broker_options` added.
        environment: environment variables.

    Raises:
        ValueError: an option is invalid; the text gives the reason.
    """
    broker = BrokerConfig.from_url(options.broker)
    if options.username is not None:
        broker = replace(broker, username=options.username)
    password = _password(options.password_file, environment)
    if password is not None:
        broker = replace(broker, password=password)
    if broker.password is not None and broker.username is None:
        raise ValueError("a password needs a user name: --username NAME")
    files = {"--ca-file": options.ca_file, "--cert-file": options.cert_file}
    files["--key-file"] = options.key_file
    given = [name for name, path in files.items() if path is not None]
    if not given:
        return broker
    if broker.tls is None:
        raise ValueError(f"{given[0]} needs TLS: begin the URL of the broker with mqtts://")
    if options.key_file is not None and options.cert_file is None:
        raise ValueError("--key-file needs --cert-file")
    return replace(broker, tls=_tls(options.ca_file, options.cert_file, options.key_file))


def _password(path: Path | None, environment: Mapping[str, str]) -> str | None:
    if path is None:
        return environment.get(PASSWORD_VARIABLE)
    try:
        lines = path.read_text("utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"cannot read the password from {path}: {_reason(error)}") from None
    if not lines or not lines[0]:
        raise ValueError(f"there is no password in the first line of {path}")
    return lines[0]


def _tls(ca_file: Path | None, cert_file: Path | None, key_file: Path | None) -> ssl.SSLContext:
    def no_password() -> str:
        raise ValueError("the private key is encrypted; decrypt it, and protect its file instead")

    try:
        context = ssl.create_default_context(cafile=ca_file)
    except OSError as error:
        raise ValueError(f"cannot use the certificates in {ca_file}: {_reason(error)}") from None
    if cert_file is not None:
        try:
            context.load_cert_chain(cert_file, key_file, password=no_password)
        except OSError as error:
            raise ValueError(
                f"cannot use the certificate in {cert_file} with the key in "
                f"{key_file or cert_file}: {_reason(error)}"
            ) from None
    return context


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)
