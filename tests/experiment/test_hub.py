"""The Hub, against a stub of its interface on the loopback and in offline mode."""

import base64
import hashlib
import json
import shutil
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import ClassVar
from urllib.parse import urlsplit

import pytest

import knowarm
from knowarm.cli.main import main
from knowarm.errors import UserError
from knowarm.experiment.hub import _access, push_to_hub
from tests.forked import Forked
from tests.source_tree import ROOT

pytest.importorskip("huggingface_hub")
ZOO = ROOT / "zoo/irb120-full-fast"
COMMIT = "0" * 39 + "1"


class Hub(BaseHTTPRequestHandler):
    """Answers what huggingface_hub asks for on uploading and downloading; keeps files in memory."""

    repos: ClassVar[dict] = {}

    def log_message(self, *arguments):
        pass

    def answer(self, values, status=200, headers=()):
        body = values if isinstance(values, bytes) else json.dumps(values).encode()
        self.send_response(status)
        for name, value in {"Content-Length": str(len(body)), **dict(headers)}.items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def do_POST(self):
        body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        path = urlsplit(self.path).path
        if path == "/api/repos/create":
            asked = json.loads(body)
            name = (
                f"{asked['organization']}/{asked['name']}"
                if asked.get("organization")
                else asked["name"]
            )
            self.repos.setdefault(name, {})
            return self.answer({"url": f"{self.address()}/{name}", "name": name})
        if path == "/api/validate-yaml":
            return self.answer({"errors": [], "warnings": []})
        repo = "/".join(path.split("/")[3:5])
        if "/preupload/" in path:
            files = [
                {"path": f["path"], "uploadMode": "regular", "shouldIgnore": False}
                for f in json.loads(body)["files"]
            ]
            return self.answer({"files": files})
        for line in body.splitlines():
            item = json.loads(line)
            if item["key"] == "file":
                self.repos[repo][item["value"]["path"]] = base64.b64decode(
                    item["value"]["content"]
                )
        return self.answer(
            {
                "commitUrl": f"{self.address()}/{repo}/commit/{COMMIT}",
                "commitOid": COMMIT,
            }
        )

    def address(self):
        return f"http://{self.headers['Host']}"

    def do_HEAD(self):
        self.do_GET()

    def do_GET(self):
        parts = urlsplit(self.path).path.strip("/").split("/")
        repo = "/".join(parts[2:4] if parts[0] == "api" else parts[:2])
        if repo not in self.repos:
            return self.answer(
                {"error": "Repository not found"}, 404, {"X-Error-Code": "RepoNotFound"}
            )
        files = self.repos[repo]
        if parts[0] == "api":
            if "tree" in parts:
                return self.answer(
                    [
                        {"type": "file", "path": n, "size": len(d), "oid": "0" * 40}
                        for n, d in files.items()
                    ]
                )
            return self.answer(
                {
                    "id": repo,
                    "sha": COMMIT,
                    "siblings": [{"rfilename": n} for n in files],
                }
            )
        name = "/".join(parts[4:])
        if name not in files:  # clients leave ".." out of an address
            name = next(each for each in files if each.endswith(f"/{parts[-1]}"))
        data = files[name]
        tag = hashlib.sha256(data).hexdigest()
        return self.answer(data, headers={"X-Repo-Commit": COMMIT, "ETag": f'"{tag}"'})


@pytest.fixture
def hub(tmp_path):
    """A stub of the Hub, and a function that runs a command, or loads a policy, against it."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), Hub)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    Hub.repos = {}

    def run(*arguments, load=None, **variables):
        # huggingface_hub reads its settings from the environment when it is imported
        environment = {
            "HF_ENDPOINT": f"http://127.0.0.1:{server.server_address[1]}",
            "HF_HOME": str(tmp_path / "cache"),
            "HF_HUB_DISABLE_XET": "1",
            "HF_TOKEN": "hf_test",
            "COLUMNS": "200",
            **variables,
        }
        done = Forked(
            load or (lambda: main(["hub", *map(str, arguments)])),
            tmp_path,
            environment=environment,
            forget=["huggingface_hub"],
        )
        assert done.ended(300)
        return done

    yield run
    server.shutdown()
    server.server_close()


def load():
    trained = knowarm.from_pretrained("someone/reach")
    print(
        trained.step, sum(float(p.double().sum()) for p in trained.policy.parameters())
    )


@pytest.mark.slow(20)
def test_a_run_goes_to_the_hub_and_back(hub, tmp_path):
    run = shutil.copytree(ZOO, tmp_path / "run")
    (run / "graphs" / "0a1b2c3d").mkdir(parents=True)
    (run / "graphs" / "0a1b2c3d" / "mine.ttl").write_text("<a> <b> <c> .\n")
    done = hub("push", run, "someone/reach")
    assert done.returncode == 0, done.stderr
    assert "/someone/reach" in done.stdout
    card = Hub.repos["someone/reach"]["README.md"].decode()
    assert "irb120-full-fast" in card
    assert "algorithm fast, 1,500,000 steps" in card
    assert "library_name: knowarm" in card
    assert not any("latest" in name for name in Hub.repos["someone/reach"])
    assert "graphs/0a1b2c3d/mine.ttl" in Hub.repos["someone/reach"]
    Hub.repos["someone/reach"] |= {"model.pkl": b"evil", "run.exe": b"evil"}
    loaded = hub(load=load)
    assert loaded.returncode == 0, loaded.stderr
    assert not [*tmp_path.rglob("model.pkl"), *tmp_path.rglob("run.exe")]
    own = knowarm.load_agent(ZOO)
    weights = sum(
        float(each.detach().double().sum()) for each in own.policy.parameters()
    )
    assert loaded.stdout.split() == [str(own.step), str(weights)]

    offline = hub(load=load, HF_HUB_OFFLINE="1", HF_ENDPOINT="http://127.0.0.1:9")
    assert offline.stdout == loaded.stdout
    other = hub("pull", "someone/other", HF_HUB_OFFLINE="1")
    assert other.returncode == 2
    assert "someone/other" in other.stderr


def test_a_link_is_not_uploaded(tmp_path):
    run = shutil.copytree(ZOO, tmp_path / "run")
    (run / "graphs" / "0a1b2c3d").mkdir(parents=True)
    (run / "graphs" / "0a1b2c3d" / "id_rsa").symlink_to("/etc/passwd")
    with pytest.raises(UserError, match=r"id_rsa is a link to /etc/passwd"):
        push_to_hub(run, "someone/reach")
    network = tmp_path / "network.safetensors"
    network.symlink_to("/etc/passwd")
    with pytest.raises(UserError, match=r"network\.safetensors is a link\. "):
        push_to_hub(network, "someone/network")


@pytest.mark.parametrize(
    "error",
    [
        KeyError("sha"),
        ValueError("401\nbad token hf_1"),
        UnicodeEncodeError("ascii", "\xe9", 0, 1, "no"),
    ],
)
def test_what_the_hub_answers_is_one_line(error):
    """huggingface_hub raises many types for answers that it does not expect."""
    with (
        pytest.raises(UserError, match="The Hub did not serve a/b: ") as caught,
        _access("a/b"),
    ):
        raise error
    assert "\n" not in str(caught.value)
    assert "hf_1" not in str(caught.value)


@pytest.mark.slow(8)
def test_a_pack_is_shared_as_a_file(hub, tmp_path):
    pack = tmp_path / "study.tar.xz"
    pack.write_bytes(b"packed")
    assert hub("push", pack, "someone/study").returncode == 0
    assert hub("pull", "someone/study", "--to", tmp_path / "there").returncode == 0
    assert (tmp_path / "there/study.tar.xz").read_bytes() == b"packed"
    unreachable = hub(
        "pull", "someone/study", "--to", tmp_path, HF_ENDPOINT="http://127.0.0.1:1"
    )
    assert unreachable.returncode == 2, unreachable.stdout
    assert "Check the connection" in unreachable.stderr


OUTSIDE = (
    "../stolen.safetensors",
    "../../../stolen.safetensors",
    "graphs/../../stolen.ttl",
    "graphs/../../../../stolen.ttl",
    "checkpoints/best/../../../stolen.json",
    "/stolen.safetensors",
    "{tmp_path}/stolen.safetensors",
)


@pytest.mark.slow(8)
def test_a_repository_writes_nothing_outside_of_its_folder(hub, tmp_path):
    folders = [tmp_path / "cache"]
    commands = []
    for number, name in enumerate(OUTSIDE):
        files = {name.format(tmp_path=tmp_path): b"stolen", "README.md": b"card"}
        Hub.repos[f"someone/evil{number}"] = files
        folders.append(tmp_path / "a" / "b" / f"there{number}")
        pull = ["hub", "pull", f"someone/evil{number}"]
        commands += [[*pull, "--to", str(folders[-1])], pull]

    done = hub(load=lambda: print(*map(main, commands)))
    assert done.returncode == 0
    codes = done.stdout.splitlines()[-1].split()
    assert len(codes) == len(commands)
    assert {*codes} <= {"0", "2"}
    assert "Traceback" not in done.stderr
    stolen = [path for path in tmp_path.rglob("*") if path.name.startswith("stolen")]
    assert all(any(map(path.is_relative_to, folders)) for path in stolen), stolen


@pytest.mark.slow(8)
def test_mistakes_end_in_one_line(hub, tmp_path):
    for arguments, words in (
        (("pull", "someone/nothing"), "Check owner, name and revision"),
        (("pull", "no//name"), "is no repository owner/name"),
        (("push", tmp_path, "someone/empty"), "is not a run folder"),
    ):
        done = hub(*arguments)
        assert done.returncode == 2, done.stderr
        assert words in done.stderr
        assert "Traceback" not in done.stderr
