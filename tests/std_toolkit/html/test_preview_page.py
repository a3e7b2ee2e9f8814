"""The preview page of live programs: own scripts alone, and own addresses alone."""

from __future__ import annotations

import urllib.error
import urllib.request

import pytest

from std_toolkit.html.page import script_digest
from std_toolkit.html.preview import PreviewPage


def asked(page: PreviewPage, path: str = "", **headers: str) -> tuple[bytes, dict[str, str]]:
    request = urllib.request.Request(f"{page.address}{path}", headers=headers)
    with urllib.request.urlopen(request, timeout=5) as answer:
        return answer.read(), dict(answer.headers)


def test_only_its_own_script_runs() -> None:
    with PreviewPage(0) as page:
        body, headers = asked(page)
    policy = headers["Content-Security-Policy"]
    script = body.decode().partition("<script>")[2].partition("</script>")[0]
    assert f"script-src '{script_digest(script)}';" in policy
    assert policy.startswith("default-src 'none'")


def test_a_rebound_name_gets_no_picture() -> None:
    with PreviewPage(0) as page:
        page.show(b"picture")
        assert asked(page, "preview.jpg")[0] == b"picture"
        with pytest.raises(urllib.error.HTTPError) as refused:
            asked(page, "preview.jpg", Host="evil.example:80")
    assert refused.value.code == 403


def test_a_token_is_asked_for() -> None:
    with PreviewPage(0, token="s3cret") as page:
        page.show(b"picture")
        for path in ("", "preview.jpg", "?token=", "preview.jpg?token=other"):
            with pytest.raises(urllib.error.HTTPError) as refused:
                asked(page, path)
            assert refused.value.code == 403
        assert asked(page, "preview.jpg?t=1&token=s3cret")[0] == b"picture"
        assert b"<script>" in asked(page, "?token=s3cret")[0]
