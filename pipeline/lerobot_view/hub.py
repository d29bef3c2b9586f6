"""The Hugging Face Hub, only ever written to, and only when somebody asks for it."""

import re
from contextlib import suppress
from pathlib import Path

from pipeline.errors import DatasetError, one_line

REPOSITORY = re.compile(r"[A-Za-z0-9][\w.-]{0,95}/[A-Za-z0-9][\w.-]{0,95}")


def check_repository(name: str) -> str:
    """A USER/NAME, or an error.

    Raises:
        DatasetError: it is none.
    """
    if REPOSITORY.fullmatch(name) is None:
        raise DatasetError(f"{name!r} is no USER/NAME of the Hub", where=f"--push-to {name}",
                           mend="write it so: --push-to ada/my-arm")
    return name


def push(folder: Path, repository: str, version: str) -> str:
    """Upload a dataset folder, tag it as LeRobot asks, and return its address. A new repository is private.

    Args:
        folder: a plain copy of a version.
        repository: USER/NAME.
        version: id of the version, for the message of the commit.

    Raises:
        DatasetError: the Hub refused or was not reached; the folder stays as it is.
    """
    from huggingface_hub import HfApi
    from huggingface_hub.errors import HfHubHTTPError, RevisionNotFoundError

    api = HfApi()
    try:
        if not api.repo_exists(repository, repo_type="dataset"):
            api.create_repo(repository, repo_type="dataset", private=True)
        api.upload_folder(repo_id=repository, repo_type="dataset", folder_path=folder,
                          commit_message=f"Hardcase dataset version {version}")
        with suppress(RevisionNotFoundError):  # the first upload has no tag to replace
            api.delete_tag(repository, tag="v3.0", repo_type="dataset")
        api.create_tag(repository, tag="v3.0", repo_type="dataset")
    except (HfHubHTTPError, OSError, ValueError) as error:
        reason = one_line(error)[:200]
        raise DatasetError(f"the upload failed: {reason}", where=f"--push-to {repository}",
                           mend=f"log in (hf auth login) and try again; the copy is there: {folder}") from error
    return f"https://huggingface.co/datasets/{repository}"
