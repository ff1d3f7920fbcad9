"""The connection to the broker: TLS, user name and password, client certificates, access rights."""

from __future__ import annotations

import argparse
import asyncio
import base64
import hashlib
import logging
import os
import shutil
import subprocess
from collections.abc import Callable, Iterator
from functools import partial
from itertools import chain
from pathlib import Path

import pytest

from tests.asynchronous import eventually
from tests.vda5050.broker import Mosquitto, free_port, mosquitto_path
from tests.vda5050.conftest import Site
from tests.vda5050.master import Master
from woosh_robot_agent.vda5050 import mqtt
from woosh_robot_agent.vda5050.mqtt import BrokerConfig, add_broker_options, broker_config

SERIAL = "30001"
"""Serial number of the simulated robot, and its user name."""
PASSWORD = "pass word: #1"
ACCESS = """\
pattern read uagv/+/+/%u/order
pattern read uagv/+/+/%u/instantActions
pattern read uagv/+/+/%u/zoneSet
pattern write uagv/+/+/%u/state
pattern write uagv/+/+/%u/visualization
pattern readwrite uagv/+/+/%u/connection
pattern write uagv/+/+/%u/factsheet
"""
"""Rights of vehicles at a broker, each with its serial number as user name."""


def openssl_path() -> str | None:
    return shutil.which("openssl")


class Authority:
    """A certificate authority with its files in a folder.

    Attributes:
        certificate: its own certificate.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir()
        self._folder = folder
        self.certificate = folder / "ca.crt"
        self._key = folder / "ca.key"
        self.run(
            *("req", "-x509", "-new", "-nodes", "-days", "2", "-subj", "/CN=test authority"),
            *("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1"),
            *("-addext", "keyUsage=critical,keyCertSign,cRLSign"),
            *("-keyout", self._key, "-out", self.certificate),
        )

    def issue(self, name: str) -> tuple[Path, Path]:
        """Make a certificate for a name at 127.0.0.1; return its file and that of its key."""
        certificate, key, request, extensions = (
            self._folder / f"{name}.{suffix}" for suffix in ("crt", "key", "csr", "ext")
        )
        extensions.write_text("subjectAltName=IP:127.0.0.1\n")
        self.run(
            *("req", "-new", "-nodes", "-subj", f"/CN={name}", "-newkey", "ec"),
            *("-pkeyopt", "ec_paramgen_curve:prime256v1", "-keyout", key, "-out", request),
        )
        self.run(
            *("x509", "-req", "-days", "2", "-in", request, "-out", certificate),
            *("-CA", self.certificate, "-CAkey", self._key, "-CAcreateserial"),
            *("-extfile", extensions),
        )
        return certificate, key

    def run(self, *arguments: object) -> None:
        path = openssl_path()
        assert path
        subprocess.run([path, *map(str, arguments)], check=True, capture_output=True)


def hashed(user: str, password: str) -> str:
    """A line of mosquitto's password file."""
    salt = os.urandom(12)
    digest = hashlib.pbkdf2_hmac("sha512", password.encode(), salt, 101)
    return f"{user}:$7$101${base64.b64encode(salt).decode()}${base64.b64encode(digest).decode()}\n"


class SecureMosquitto(Mosquitto):
    """A broker with further listeners for vehicles: with passwords, with TLS, and with both ends'
    certificates. The first listener is for the tests."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.password_port, self.tls_port, self.certificate_port = (free_port() for _ in range(3))
        self.authority = Authority(folder / "ca")
        self._certificate, self._key = self.authority.issue("broker")
        self._passwords = folder / "passwords"
        self._passwords.write_text(hashed(SERIAL, PASSWORD) + hashed("other", PASSWORD))
        self._access = folder / "access"
        self._access.write_text(ACCESS)

    def settings(self) -> str:
        tls = [
            f"cafile {self.authority.certificate}",
            f"certfile {self._certificate}",
            f"keyfile {self._key}",
        ]
        login = ["allow_anonymous false", f"acl_file {self._access}"]
        password = [*login, f"password_file {self._passwords}"]
        return "\n".join(
            [
                "per_listener_settings true",
                super().settings(),
                f"listener {self.password_port} 127.0.0.1",
                *password,
                f"listener {self.tls_port} 127.0.0.1",
                *password,
                *tls,
                f"listener {self.certificate_port} 127.0.0.1",
                *login,
                *tls,
                "require_certificate true",
                "use_identity_as_username true",
                "",
            ]
        )


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[SecureMosquitto]:
    if mosquitto_path() is None or openssl_path() is None:
        pytest.skip("mosquitto or openssl is not installed")
    with SecureMosquitto(tmp_path) as mosquitto:
        yield mosquitto


def options(url: str, *arguments: object, **environment: str) -> BrokerConfig:
    """The broker as the command line of the connector gives it."""
    parser = argparse.ArgumentParser()
    add_broker_options(parser)
    return broker_config(parser.parse_args(["--broker", url, *map(str, arguments)]), environment)


Login = Callable[[SecureMosquitto, Path], BrokerConfig]
Renewal = tuple[BrokerConfig, Callable[[], object]]
"""A login with files that are out of date, and a function that renews them."""
UNTRUSTED = ("certificate verify failed", "certificate of the broker's authority")


def password_from_file(broker: SecureMosquitto, folder: Path) -> BrokerConfig:
    file = folder / "password"
    file.write_text(PASSWORD + "\n")
    url = f"mqtt://127.0.0.1:{broker.password_port}"
    return options(url, "--username", SERIAL, "--password-file", file)


def tls_and_password_from_environment(
    broker: SecureMosquitto, folder: Path, host: str = "127.0.0.1", authority: Path | None = None
) -> BrokerConfig:
    url = f"mqtts://{SERIAL}@{host}:{broker.tls_port}"
    ca = authority or broker.authority.certificate
    return options(url, "--ca-file", ca, VDA5050_PASSWORD=PASSWORD)


def client_certificate(broker: SecureMosquitto, folder: Path) -> BrokerConfig:
    certificate, key = broker.authority.issue(SERIAL)
    return options(
        f"mqtts://127.0.0.1:{broker.certificate_port}",
        *("--ca-file", broker.authority.certificate),
        *("--cert-file", certificate, "--key-file", key),
        VDA5050_PASSWORD="",  # the same as no password
    )


async def test_each_login_connects(site: Site, tmp_path: Path) -> None:
    for login in (password_from_file, tls_and_password_from_environment, client_certificate):
        config = login(site.broker, tmp_path)
        async with Master(site.broker.port) as master, site.vehicle(config):
            await master.online()


async def test_a_wrong_password_is_said_once_and_the_right_one_is_never_shown(
    site: Site, caplog: pytest.LogCaptureFixture
) -> None:
    url = f"mqtt://{SERIAL}@127.0.0.1:{site.broker.password_port}"
    config = options(url, VDA5050_PASSWORD="wrong secret")
    with caplog.at_level(logging.INFO):
        async with site.vehicle(config):
            await eventually(lambda: refusals(caplog))
            await asyncio.sleep(1.5)  # time for further attempts
    (refusal,) = refusals(caplog)
    assert "ot authori" in refusal
    assert "wrong secret" not in caplog.text + repr(config)


def refusals(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [
        record.getMessage()
        for record in caplog.records
        if record.levelno >= logging.WARNING
        and "no connection to the broker" in record.getMessage()
    ]


def certificate_of_another_authority(broker: SecureMosquitto, folder: Path) -> BrokerConfig:
    stranger = Authority(folder / "stranger").certificate
    return tls_and_password_from_environment(broker, folder, authority=stranger)


def certificate_of_another_name(broker: SecureMosquitto, folder: Path) -> BrokerConfig:
    return tls_and_password_from_environment(broker, folder, host="localhost")


def no_client_certificate(broker: SecureMosquitto, folder: Path) -> BrokerConfig:
    url = f"mqtts://127.0.0.1:{broker.certificate_port}"
    return options(url, "--ca-file", broker.authority.certificate)


async def test_without_the_right_certificates_there_is_no_connection(
    site: Site,
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # the broker does not answer a client without a certificate
    monkeypatch.setattr(mqtt, "_Client", partial(mqtt._Client, timeout=2.0))
    refused: list[tuple[Login, tuple[str, ...]]] = [
        (certificate_of_another_authority, UNTRUSTED),
        (certificate_of_another_name, UNTRUSTED),
        (no_client_certificate, ()),
    ]
    for login, reasons in refused:
        caplog.clear()
        async with site.vehicle(login(site.broker, tmp_path)):
            await eventually(lambda: refusals(caplog), login.__name__)
        for reason in reasons:
            assert reason in refusals(caplog)[0], login.__name__
        assert site.recorder.messages == [], login.__name__


def renewed_password(broker: SecureMosquitto, folder: Path) -> Renewal:
    config = password_from_file(broker, folder)
    (folder / "password").write_text("an old password")
    return config, lambda: password_from_file(broker, folder)


def renewed_certificates(broker: SecureMosquitto, folder: Path) -> Renewal:
    stranger = Authority(folder / "stranger")
    files = [folder / name for name in ("ca.crt", "robot.crt", "robot.key")]
    copy(files, stranger.certificate, *stranger.issue(SERIAL))
    renew = partial(copy, files, broker.authority.certificate, *broker.authority.issue(SERIAL))
    names = ("--ca-file", "--cert-file", "--key-file")
    arguments = chain.from_iterable(zip(names, files, strict=True))
    return options(f"mqtts://127.0.0.1:{broker.certificate_port}", *arguments), renew


def copy(targets: list[Path], *sources: Path) -> None:
    for target, source in zip(targets, sources, strict=True):
        target.write_bytes(source.read_bytes())


@pytest.mark.parametrize("login", [renewed_password, renewed_certificates])
async def test_files_that_are_renewed_are_used_without_a_restart(
    site: Site,
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
    login: Callable[[SecureMosquitto, Path], Renewal],
) -> None:
    config, renew = login(site.broker, tmp_path)
    async with Master(site.broker.port) as master, site.vehicle(config):
        await eventually(lambda: refusals(caplog))
        renew()
        await master.online()


async def test_a_file_that_cannot_be_used_for_a_while_ends_nothing(
    site: Site, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    config = password_from_file(site.broker, tmp_path)
    (tmp_path / "password").unlink()
    async with Master(site.broker.port) as master, site.vehicle(config):
        await eventually(lambda: refusals(caplog))
        assert f"cannot read the password from {tmp_path}" in refusals(caplog)[0]
        password_from_file(site.broker, tmp_path)
        await master.online()


async def test_a_vehicle_may_use_its_own_topics_only(
    site: Site, caplog: pytest.LogCaptureFixture
) -> None:
    port = site.broker.password_port
    config = BrokerConfig("127.0.0.1", port, username=SERIAL, password=PASSWORD)
    async with Master(site.broker.port) as master:
        with caplog.at_level(logging.INFO):
            async with site.vehicle(config, serial_number="other"):  # not that of the user name
                await eventually(lambda: "connected to the broker" in caplog.text)
        async with site.vehicle(config):
            await master.online()
        await eventually(lambda: master.last("connection")["connectionState"] == "OFFLINE")
    assert {topic.split("/")[3] for topic, _ in site.recorder.messages} == {SERIAL}


def test_the_documented_rights_are_those_of_the_tests() -> None:
    assert ACCESS in (Path(__file__).parents[2] / "docs/vda5050.md").read_text()


@pytest.mark.parametrize(
    ("arguments", "environment", "text"),
    [
        (["http://host"], {}, "begins with mqtt"),
        (["mqtt://host:99999"], {}, "out of range"),
        (["mqtt://host", "--ca-file", "ca.crt"], {}, "needs TLS"),
        (["mqtts://host", "--ca-file", "/none/ca.crt"], {}, "No such file"),
        (["mqtts://host", "--key-file", "k"], {}, "--key-file needs --cert-file"),
        (["mqtts://host", "--cert-file", "/none/c"], {}, "No such file"),
        # the client certificate first, because a bad one must not cost the time for the authorities
        (["mqtts://host", "--ca-file", "/none/a", "--cert-file", "/none/c"], {}, "in /none/c with"),
        (["mqtt://host"], {"VDA5050_PASSWORD": "x"}, "needs a user name"),
        (["mqtt://u@host", "--password-file", "/none/p"], {}, "No such file"),
        (["mqtt://u@host", "--password-file", os.devnull], {}, "no password in"),
    ],
)
def test_a_wrong_option_is_refused_with_its_reason(
    arguments: list[str], environment: dict[str, str], text: str
) -> None:
    with pytest.raises(ValueError, match=text):
        options(*arguments, **environment)


def test_an_encrypted_key_is_refused_instead_of_asking_for_its_password(tmp_path: Path) -> None:
    if openssl_path() is None:
        pytest.skip("openssl is not installed")
    authority = Authority(tmp_path / "ca")
    certificate, key = authority.issue("robot")
    encrypted = tmp_path / "encrypted.key"
    authority.run("ec", "-in", key, "-aes256", "-passout", "pass:1234", "-out", encrypted)
    with pytest.raises(ValueError, match="the private key is encrypted"):
        options("mqtts://host", "--cert-file", certificate, "--key-file", encrypted)
