"""Archives of photographs: names, stores, and a Dask cluster of this machine whose processes are killed."""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

import chromaperture as cap
from chromaperture.frame import frame_files
from chromaperture.products import archive, archive_store
from chromaperture.system import cluster
from chromaperture.system.errors import InputError
from clusters import LocalCluster, sleep_or_die

SAMPLE = "still_life_cy_halves"
CAMERA = cap.sample_camera(SAMPLE)
NAMES = ("depth.tiff", "sigma.tiff", "json")
WRITE = "depth,sigma"


def photographs(folder, count):
    folder.mkdir(parents=True, exist_ok=True)
    return [str(shutil.copy(cap.sample_image(SAMPLE), folder / f"p{i}.png")) for i in range(count)]


def recipe(**options):
    return archive.recipe_for(CAMERA, cap.load_camera(CAMERA, quality="real-time"), write=WRITE, **options)


def results(folder):
    """Content of the result files by name; of JSON what does not differ between runs and places."""
    found = {}
    for path in sorted(folder.iterdir()):
        found[path.name] = path.read_bytes()
        if path.suffix == ".json":
            content = json.loads(found[path.name])
            found[path.name] = {k: v for k, v in content.items() if k not in ("seconds", "made_from")}
    return found


def alone(images, folder):
    for image in images:
        cap.measure_file(image, cap.load_camera(CAMERA, quality="real-time"), out=folder, write=f"{WRITE},json")
    return results(folder)


def ended(image, made):
    outcome = archive.measure_photograph(str(image), made)
    assert outcome.error == ""
    return "kept" if outcome.kept else "measured"


# ---- on a cluster


@pytest.mark.slow
@pytest.mark.extra("cluster", "distributed")
def test_a_cluster_gives_the_same_files_and_keeps_what_is_complete(run, tmp_path):
    images = photographs(tmp_path / "in", 3)
    (tmp_path / "in" / "bad.png").write_bytes(b"no picture")
    started = LocalCluster(tmp_path)
    try:
        command = ("depth", tmp_path / "in", "-c", CAMERA, "--quality=real-time", "--write", WRITE)
        command += ("--out", tmp_path / "out")
        first = run(*command, "--cluster", started.address, "-q")
        second = run(*command, "--cluster", started.address, "--json")
    finally:
        started.close()
    assert first.returncode == second.returncode == 1
    (line,) = first.stderr.splitlines()
    assert "bad.png" in line
    assert "damaged" in line
    assert results(tmp_path / "out") == alone(images, tmp_path / "alone")
    summary = json.loads(second.stdout)
    assert (summary["measured"], summary["kept"]) == (0, 3)
    assert [os.path.basename(failure["image"]) for failure in summary["failed"]] == ["bad.png"]


@pytest.mark.slow
@pytest.mark.extra("cluster", "distributed")
def test_nothing_is_lost_with_a_worker_or_with_the_scheduler(tmp_path):
    images, made = photographs(tmp_path / "in", 8), recipe(out=str(tmp_path / "out"))
    started, seen, at_kill = LocalCluster(tmp_path), [], []
    try:
        with pytest.raises(InputError, match="the cluster was lost"):
            for outcome in archive.measure_on_cluster(images, made, started.address):
                seen.append(outcome)
                if len(seen) == 1:
                    at_kill = [worker for worker in started.workers if worker.poll() is None]
                    os.kill(started.workers[0].pid, signal.SIGKILL)
                elif len(seen) == 3:
                    os.kill(started.scheduler.pid, signal.SIGKILL)
        assert started.workers[0].wait(timeout=10) == -signal.SIGKILL
    finally:
        started.close()
    assert len(at_kill) == 2
    assert [outcome.error for outcome in seen] == [""] * len(seen)
    complete = {path.name for path in (tmp_path / "out").glob("*.json")}
    assert len(seen) <= len(complete) < 8
    before = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "out").glob("*.json")}
    started = LocalCluster(tmp_path)
    try:
        again = list(archive.measure_on_cluster(images, made, started.address))
    finally:
        started.close()
    assert {f"{Path(o.image).stem}.json" for o in again if o.kept} == complete
    assert not [outcome.error for outcome in again if outcome.error]
    assert {name: (tmp_path / "out" / name).stat().st_mtime_ns for name in before} == before
    private = [path for path in (tmp_path / "out").iterdir() if path.name.startswith(".chromaperture-")]
    for path in private:  # of the killed worker, in the middle of writing
        shutil.rmtree(path)
    assert results(tmp_path / "out") == alone(images, tmp_path / "alone")


@pytest.mark.slow
@pytest.mark.extra("cluster", "distributed")
def test_a_worker_with_another_version_is_refused_whenever_it_joins(tmp_path):
    installed = tmp_path / "other" / "chromaperture-99.0.dist-info"
    installed.mkdir(parents=True)
    (installed / "METADATA").write_text("Metadata-Version: 2.1\nName: chromaperture\nVersion: 99.0\n")
    path = os.pathsep.join([str(tmp_path / "other"), *(p for p in sys.path if p)])
    started = LocalCluster(tmp_path, workers=0)
    try:
        started.add_worker(PYTHONPATH=path)
        with pytest.raises(InputError, match=r"has chromaperture 99\.0: install"):
            next(archive.measure_on_cluster(["a.png"], recipe(), started.address))
    finally:
        started.close()
    other = dataclasses.replace(recipe(), made_from=(("version", "98.0"),))  # as that worker sees this run
    joined = archive.measure_photograph("a.png", other)
    with pytest.raises(InputError, match="all workers"):
        cluster.check_version("tcp://10.0.0.2:1", "99.0")
    assert joined.error
    assert joined.version != "98.0"


@pytest.fixture
def certificates(tmp_path):
    """An authority, and a certificate that it signed; what `docs/archives.md` shows."""
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not installed: TLS is NOT tested")

    def openssl(*arguments):
        subprocess.run(["openssl", *arguments], cwd=tmp_path, check=True, capture_output=True, timeout=60)

    key = ("-newkey", "rsa:2048", "-nodes")
    openssl("req", "-x509", *key, "-days", "2", "-subj", "/CN=authority", "-keyout", "ca.key", "-out", "ca.pem")
    openssl("req", *key, "-subj", "/CN=member", "-keyout", "member.key", "-out", "member.csr")
    signed = ("-CA", "ca.pem", "-CAkey", "ca.key", "-CAcreateserial", "-days", "2")
    openssl("x509", "-req", "-in", "member.csr", *signed, "-out", "member.pem")
    return {"tls-ca-file": tmp_path / "ca.pem", "tls-cert": tmp_path / "member.pem", "tls-key": tmp_path / "member.key"}


@pytest.mark.slow
@pytest.mark.extra("cluster", "distributed")
def test_tls_works_with_dasks_own_settings_and_refuses_who_has_no_certificate(certificates, tmp_path, monkeypatch):
    import dask
    import distributed  # noqa: F401, its settings are those of Dask

    names = {"ca-file": "tls-ca-file", "client.cert": "tls-cert", "client.key": "tls-key"}
    settings = {f"distributed.comm.tls.{name}": str(certificates[option]) for name, option in names.items()}
    started = LocalCluster(tmp_path, workers=1, tls=certificates)
    try:
        with dask.config.set(settings), cluster.connected(started.address) as client:
            (found,) = cluster.run_tasks(client, sleep_or_die, ["a"], 0.0)
            assert found.value == "a"
        monkeypatch.setattr(cluster, "CONNECT_S", 2)
        unencrypted = started.address.replace("tls:", "tcp:")
        for address in (started.address, unencrypted):
            with pytest.raises(InputError, match="no Dask scheduler"), cluster.connected(address):
                pass
    finally:
        started.close()


# ---- one photograph, without a cluster


@pytest.mark.slow
def test_what_is_complete_is_measured_again_only_with_a_damaged_mark_or_another_camera(tmp_path):
    (image,) = photographs(tmp_path / "in", 1)
    made, out = recipe(out=str(tmp_path / "out")), tmp_path / "out"
    assert ended(image, made) == "measured"
    assert {path.name for path in out.iterdir()} == {f"p0.{name}" for name in NAMES}
    assert ended(image, made) == "kept"
    (out / "p0.json").write_text("[")
    assert ended(image, made) == "measured"
    opened = cap.load_camera(CAMERA, quality="real-time")
    copied = shutil.copy(cap.sample_camera("still_life_cy_open"), tmp_path)
    other = archive.recipe_for(copied, opened, write=WRITE, out=str(out))
    assert ended(image, other) == "measured"


def test_results_of_two_settings_are_never_taken_for_complete(tmp_path, monkeypatch):
    """The mark goes before files are replaced: else the old one would stand beside files of an interrupted run."""
    (image,) = photographs(tmp_path / "in", 1)
    made = recipe(out=str(tmp_path / "out"))
    assert ended(image, made) == "measured"
    with monkeypatch.context() as failing:

        def full(*arguments, **options):
            raise OSError(28, "No space left on device")

        failing.setattr(frame_files, "write_float_tiff", full)
        outcome = archive.measure_photograph(str(image), recipe(out=str(tmp_path / "out"), black_level=1.0))
    assert "disk is full" in outcome.error
    assert not (tmp_path / "out" / "p0.json").exists()
    assert ended(image, made) == "measured"


def test_a_warning_comes_back_with_the_outcome(tmp_path):
    from PIL import Image

    (image,) = photographs(tmp_path / "in", 1)
    picture = tmp_path / "photo.jpg"
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.new("RGB", (720, 480), (90, 120, 60)).save(picture, subsampling=0, exif=exif)
    outcome = archive.measure_photograph(str(picture), recipe(out=str(tmp_path / "out")))
    assert any("portrait orientation" in text for text in outcome.warnings)
    assert archive.measure_photograph(str(image), recipe(out=str(tmp_path / "out"))).warnings == ()


# ---- stores behind a URL


@pytest.mark.extra("cluster", "fsspec")
@pytest.mark.parametrize("whole", [True, False])
def test_a_store_gets_the_same_files_the_mark_last_and_each_whole(tmp_path, whole):
    import fsspec
    from fsspec.implementations.memory import MemoryFileSystem

    puts = []

    class Recorded(MemoryFileSystem):
        protocol = "memory" if whole else "recorded"
        store, pseudo_dirs = {}, [""]

        @classmethod
        def _strip_protocol(cls, path):
            return MemoryFileSystem._strip_protocol(path.replace("recorded://", "memory://"))

        def put_file(self, local, remote, **options):
            puts.append(remote)
            super().put_file(local, remote, **options)

    fsspec.register_implementation(Recorded.protocol, Recorded, clobber=True)
    try:
        scheme, store = Recorded.protocol, Recorded(skip_instance_cache=True)
        store.pipe_file("/archive/p0.png", cap.sample_image(SAMPLE).read_bytes())
        image = f"{scheme}://archive/p0.png"
        assert ended(image, recipe()) == "measured"
        assert ended(image, recipe()) == "kept"
    finally:
        fsspec.register_implementation("memory", MemoryFileSystem, clobber=True)
    begin = "/archive/" if whole else "/archive/.chromaperture-"
    assert puts == [f"{begin}p0.{name}" for name in NAMES]
    assert sorted(store.ls("/archive", detail=False)) == sorted(f"/archive/p0.{n}" for n in (*NAMES, "png"))
    for name in NAMES:
        (tmp_path / "got").mkdir(exist_ok=True)
        (tmp_path / "got" / f"p0.{name}").write_bytes(store.cat_file(f"/archive/p0.{name}"))
    assert results(tmp_path / "got") == alone(photographs(tmp_path / "in", 1), tmp_path / "alone")


@pytest.mark.extra("cluster", "fsspec")
def test_a_store_that_fails_is_tried_again_and_one_that_refuses_is_not(monkeypatch):
    from fsspec.implementations.memory import MemoryFileSystem

    def unreachable(self, *arguments, **options):
        raise ConnectionResetError("connection reset by peer")

    missing = archive.measure_photograph("memory://nothing/p0.png", recipe())
    assert "cannot read memory://nothing/p0.png" in missing.error
    unknown = archive.measure_photograph("nonsense://a/p0.png", recipe())
    assert "nonsense" in unknown.error
    monkeypatch.setattr(MemoryFileSystem, "get_file", unreachable)
    with pytest.raises(archive_store.StoreError, match="connection reset"):  # Dask runs what raises again
        archive.measure_photograph("memory://nothing/p0.png", recipe())


# ---- names


def test_folders_patterns_and_lists_name_photographs_without_results(tmp_path):
    for name in ("b.png", "a.jpg", "a.json", "a.depth.png", "a.color.png", "a.ply", "notes.txt", "in/c.tif"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"")
    found = [str(tmp_path / name) for name in ("a.jpg", "b.png")]
    assert archive_store.find_photographs([str(tmp_path)]) == found
    assert archive_store.find_photographs([f"file://{tmp_path}"]) == found
    assert archive_store.find_photographs([str(tmp_path / "*.png")]) == found[1:]
    assert archive_store.find_photographs([str(tmp_path / "**" / "*.tif")]) == [str(tmp_path / "in" / "c.tif")]
    assert archive_store.find_photographs(["missing.png"]) == ["missing.png"]  # an error of its own, later
    for nothing in (str(tmp_path / "*.dng"), str(tmp_path / "empty")):
        (tmp_path / "empty").mkdir(exist_ok=True)
        with pytest.raises(InputError, match="no photographs in"):
            archive_store.find_photographs([nothing])
    names = tmp_path / "list.txt"
    names.write_text("a b.png\n\n  s3://bucket/c.png\r\n", encoding="utf-8")
    assert archive_store.names_in_list(names) == ["a b.png", "s3://bucket/c.png"]
    names.write_bytes("ä.png\r\n".encode("utf-16"))  # by PowerShell: `ls > list.txt`
    assert archive_store.names_in_list(names) == ["ä.png"]


@pytest.mark.extra("cluster", "fsspec")
def test_folders_and_patterns_of_a_store_name_photographs():
    import fsspec

    store = fsspec.filesystem("memory")
    for name in ("b.png", "a.jpg", "a.depth.png", "a.json"):
        store.pipe_file(f"/listed/{name}", b"")
    assert archive_store.find_photographs(["memory://listed"]) == ["memory:///listed/a.jpg", "memory:///listed/b.png"]
    assert archive_store.find_photographs(["memory://listed/*.png"]) == ["memory:///listed/b.png"]


@pytest.mark.extra("cluster", "fsspec")
def test_a_store_whose_attempts_do_not_end_is_an_error(monkeypatch):
    import fsspec

    ended = threading.Event()
    monkeypatch.setattr(archive_store, "_TRANSFER_S", 0.05)
    monkeypatch.setattr(fsspec.get_filesystem_class("memory"), "get_file", lambda *args, **options: ended.wait())
    try:
        with pytest.raises(archive_store.StoreError, match="no end within"):
            archive_store.fetch("memory://listed/a.jpg", Path("a.jpg"))
    finally:
        ended.set()


def test_wrong_use_is_one_line(run, tmp_path, monkeypatch):
    (image,) = photographs(tmp_path / "in", 1)
    (tmp_path / "empty.txt").write_text("\n")
    (tmp_path / "bytes.txt").write_bytes(b"\xff\xfe\xff")
    address = ("--cluster", "tcp://127.0.0.1:9")
    wrong = {
        "give photographs": (),
        "no names": ("--files-from", tmp_path / "empty.txt"),
        "not UTF-8 text": ("--files-from", tmp_path / "bytes.txt"),
        "give its scheduler with --cluster": ("s3://bucket/photo.png",),
        "same files": (image, image, *address),
        "no Dask scheduler|pip install": (image, *address),
    }
    monkeypatch.setattr(cluster, "CONNECT_S", 1)
    for message, arguments in wrong.items():
        result = run("depth", *arguments, "--camera", CAMERA, "-q")
        assert result.returncode == 2
        assert any(part in result.stderr for part in message.split("|")), result.stderr
        assert len(result.stderr.splitlines()) == 1
    result = run("depth", image, "--design", "cy_halves", *address)
    assert "give the camera file with --camera" in result.stderr


def test_a_list_is_measured_without_a_cluster_too(run, tmp_path):
    images = photographs(tmp_path / "in", 2)
    (tmp_path / "list.txt").write_text("\n".join(map(str, images)))
    command = ("depth", "--files-from", tmp_path / "list.txt", "-c", CAMERA, "--quality=real-time", "--write=depth")
    assert run(*command).returncode == 0
    assert {path.name for path in (tmp_path / "in").glob("*.tiff")} == {"p0.depth.tiff", "p1.depth.tiff"}
