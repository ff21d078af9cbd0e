import json

from knowarm.cli.main import main


def test_a_graph_alone_answers(capsys, tmp_path):
    out = tmp_path / "answers.json"
    assert (
        main(["answer", "usedFor learning and hasColor blue", "--json", str(out)]) == 0
    )
    text = capsys.readouterr().out
    assert text.count("blue") == 3
    assert "globe" in text
    values = json.loads(out.read_text())
    assert values["query"] == "usedFor learning and hasColor blue"
    assert ["globe", "blue"] in values["answers"]


def test_a_graph_and_objects_of_the_user(capsys, tmp_path):
    graph = tmp_path / "kitchen.csv"
    graph.write_text("cup,usedFor,drinking\njug,usedFor,pouring\n")
    options = ["--graph", str(graph), "--colours", "red", "green"]
    assert main(["answer", "something to drink from", *options]) == 0
    text = capsys.readouterr().out
    assert "cup" in text
    assert "green" in text
    assert "jug" not in text


def test_a_misspelled_value_is_refused(capsys):
    assert main(["answer", "usedFor lerning"]) == 2
    assert "Did you mean 'learning'" in capsys.readouterr().err
