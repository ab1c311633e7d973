"""nginx in front of a console, configured as docs/operate/console_proxy.md shows."""

from __future__ import annotations

import http.client
import re
import socket
import ssl
from pathlib import Path

from bridge.hub.security.certificates import Authority
from tests.peers.browser.page import TestPage
from tests.support.missing import NGINX, need, nginx
from tests.support.ports import free_port
from tests.support.process import Process
from tests.support.wait import until

PAGE = Path(__file__).parents[3] / "docs" / "operate" / "console_proxy.md"
WEB = {"names": ["robots.example", "127.0.0.1"], "prefix": "/robot1"}
"""The console's settings. 127.0.0.1 is for browsers, which cannot resolve the other name."""


class Proxy:
    """nginx with the configuration from the page, in front of a console."""

    def __init__(self, folder: Path, keys: Path, console: int, *, tokens: bool = False) -> None:
        need(NGINX)
        self.port = free_port()
        self.context = ssl.create_default_context(cafile=keys / "ca.pem")
        Authority(keys).issue("proxy", ["robots.example", "127.0.0.1"])
        (folder / "users").write_text("anna:{PLAIN}secret\n")
        config, for_tokens = re.findall(r"```nginx\n(.*?)```", PAGE.read_text(), re.DOTALL)
        if tokens:
            config, lines = re.subn(r" *(auth_basic|auth_basic_user_file|proxy_pass) .*\n", "", config)
            assert lines == 3
            config = config.replace("    location /robot1/ {\n", f"    location /robot1/ {{\n{for_tokens}")
        replacements = {
            "443 ssl": f"127.0.0.1:{self.port} ssl",
            "/etc/nginx/robots.example.pem": str(keys / "proxy.pem"),
            "/etc/nginx/robots.example.key": str(keys / "proxy.key"),
            "127.0.0.1:8480": f"127.0.0.1:{console}",
            **({"/etc/midspan/keys/": f"{keys}/", "proxy_ssl_name robot1": "proxy_ssl_name here"} if tokens else
               {"/etc/nginx/robot1.htpasswd": str(folder / "users")}),
        }  # fmt: skip
        for documented, local in replacements.items():
            assert config.count(documented) == 1, documented
            config = config.replace(documented, local)
        kinds = ("client_body", "proxy", "fastcgi", "uwsgi", "scgi")
        temporary = "".join(f"{kind}_temp_path {folder}/{kind};\n" for kind in kinds)
        file = folder / "nginx.conf"
        file.write_text(
            f"daemon off; master_process off; pid {folder}/nginx.pid; error_log stderr; events {{}}\n"
            f"http {{ access_log off;\n{temporary}{config}}}\n"
        )
        self._process = Process([str(nginx()), "-p", folder, "-e", "stderr", "-c", file])
        until(self._listens, f"nginx listens; {self._process.output()}")

    def _listens(self) -> bool:
        with socket.socket() as sock:
            return sock.connect_ex(("127.0.0.1", self.port)) == 0

    def get(self, path: str, **headers: str) -> tuple[int, dict[str, str], bytes]:
        """Return the response to a request from a browser that uses the documented address."""
        connection = http.client.HTTPSConnection("127.0.0.1", self.port, timeout=10, context=self.context)
        try:
            connection.request("GET", path, headers={"Host": f"robots.example:{self.port}", **headers})
            response = connection.getresponse()
            return response.status, {k.lower(): v for k, v in response.getheaders()}, response.read()
        finally:
            connection.close()

    def page(self, origin: str = "", **headers: str) -> TestPage:
        """Open a page at the documented address."""
        return TestPage(
            self.port, url=f"wss://robots.example:{self.port}/robot1/socket", host="127.0.0.1", ssl=self.context,
            origin=origin or f"https://robots.example:{self.port}", additional_headers=headers,
        )  # fmt: skip

    def close(self) -> None:
        self._process.stop()
