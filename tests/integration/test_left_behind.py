"""What a killed run leaves behind: no process, no folder, and no keys in a folder of the user's."""

from tests.integration.processes import until


def test_a_killed_run_leaves_no_keys_where_its_user_wanted_them(tmp_path, dynpf):
    guests = tmp_path / "mine"
    guests.mkdir(mode=0o700)
    (guests / "notes.txt").write_text("the user's own")
    run = dynpf("run", "landmark-room", "--keys", guests, "-o", tmp_path / "run.mcap")
    run.says("observer and operator")
    assert (guests / "operator.key").exists()
    run.popen.kill()
    until(lambda: [path.name for path in guests.iterdir()] == ["notes.txt"], "the guard has removed the keys")
