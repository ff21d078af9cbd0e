"""Hugging Face Hub: share trained policies, grounding networks and packed studies.

A repository holds what a folder of ``zoo/`` holds: the files that `load_agent` reads, the stored
evaluations, and a model card.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import starmap
from pathlib import Path
from typing import Any

from jinja2 import Environment

from knowarm.errors import UserError, packages_of
from knowarm.escapes import markdown
from knowarm.experiment.run_folder import POLICY_FILES, RUN_FILES, RunFolder
from knowarm.reading import one_line, read_bytes, read_text

FILES = (".safetensors", ".xz")
"""Kinds of single files that can be shared: a grounding network, a packed study."""

OFFLINE = "Check the connection; HF_HUB_OFFLINE=1 searches the cache alone."
REMEDIES = {
    401: "Log in with `hf auth login`, or check the name.",
    403: "Your token may not write there.",
    404: "Check owner, name and revision.",
}
"""Remedies by the status of the Hub's answer."""


def push_to_hub(path: Path | str, repo_id: str, *, private: bool = False) -> str:
    """Upload a run, or a single file, to a repository of the Hub; return its address.

    Args:
        path: a run folder, a ``.safetensors`` network or a packed study (``.tar.xz``).
        repo_id: ``owner/name``; the repository is made if there is none.
        private: whether a new repository is visible to its owner only.

    Raises:
        UserError: no such run or file, a link, no access, or no connection.
    """
    path = Path(path)
    if path.is_file() and path.suffix in FILES:
        if path.is_symlink():
            raise UserError(f"{path} is a link. Give the file itself.")
        text = f"`{path.name}` for KnowArm."
        files = [path]
    else:
        text = _run_text(RunFolder.open(path))
        files = []
        for pattern in (*RUN_FILES, *POLICY_FILES):
            files += filter(Path.is_file, sorted(path.glob(pattern)))
        if not any(file.parent.name == "best" for file in files):
            raise UserError(f"{path} has no best policy to share: train it first.")
    base = path if path.is_dir() else path.parent
    contents = {file.relative_to(base).as_posix(): read_bytes(file) for file in files}
    contents["README.md"] = _card(repo_id, text).encode()
    with _access(repo_id) as hub:
        api = hub.HfApi(library_name="knowarm")
        api.create_repo(repo_id, private=private, exist_ok=True)
        operations = list(starmap(hub.CommitOperationAdd, contents.items()))
        commit = api.create_commit(
            repo_id, operations=operations, commit_message="Upload with KnowArm"
        )
    return str(commit.repo_url)


def pull_from_hub(
    repo_id: str,
    *,
    revision: str | None = None,
    to: Path | None = None,
) -> Path:
    """Download a repository, or take it from the cache; return its folder.

    Only what a run or a pack consists of is downloaded; its size is not limited.
    Without a connection or with ``HF_HUB_OFFLINE=1`` the cache alone is searched (not with ``to``).

    Raises:
        UserError: no such repository or revision, no access, or no connection and no copy.
    """
    with _access(repo_id) as hub:
        if to is not None:
            # Without a connection any folder that exists would be returned.
            hub.HfApi().repo_info(repo_id, revision=revision)
        single_files = [f"*{suffix}" for suffix in FILES]
        folder = hub.snapshot_download(
            repo_id,
            revision=revision,
            local_dir=to,
            allow_patterns=[*RUN_FILES, *POLICY_FILES, *single_files, "README.md"],
        )
    return Path(folder)


@contextmanager
def _access(repo_id: str) -> Iterator[Any]:
    """Yield the package of the Hub, and turn its errors into a `UserError`."""
    with packages_of("hub", "The Hub"):
        import huggingface_hub
        from huggingface_hub.utils import validate_repo_id
    try:
        validate_repo_id(repo_id)
    except ValueError as error:
        raise UserError(f"{repo_id!r} is no repository owner/name: {error}") from None
    try:
        yield huggingface_hub
    except Exception as error:
        status = getattr(getattr(error, "response", None), "status_code", None)
        remedy = REMEDIES.get(status or 0, OFFLINE)
        # What follows the first line may repeat the token.
        first = str(error).strip().partition("\n")[0]
        reason = one_line(Exception(first or type(error).__name__))
        raise UserError(
            f"The Hub did not serve {repo_id}: {reason}. {remedy}"
        ) from error


def _card(repo_id: str, text: str) -> str:
    """Return a model card with the metadata that the Hub reads."""
    tags = "[knowarm, robotics, reinforcement-learning, knowledge-graph]"
    head = f"---\nlibrary_name: knowarm\ntags: {tags}\nlicense: apache-2.0\n---\n"
    use = f'import knowarm\n\ntrained = knowarm.from_pretrained("{repo_id}")'
    return f"{head}\n# {repo_id}\n\n{text}\n\n## Use\n\n```python\n{use}\n```\n"


def _run_text(folder: RunFolder) -> str:
    """Describe a run, with success and controls of every stored evaluation."""
    path = Path(__file__).with_name("model_card.md.j2")
    environment = Environment(trim_blocks=True, lstrip_blocks=True)
    config = folder.experiment()
    text = environment.from_string(read_text(path, remedy="Install KnowArm again."))
    return text.render(
        config=config,
        robot=Path(config.env.robot).stem,
        steps=folder.steps_trained,
        summaries=folder.summaries(),
        markdown=markdown,
    ).rstrip("\n")
