"""python3 sim/campaign/test_report.py: tests the report on jobs that are done, failed, missing or of another program."""

import json
import tempfile
import unittest
from pathlib import Path

import jobs
import report
from job import program_of, read_tests


class Campaign(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = Path(folder.name)
        (self.folder / "bin").mkdir()
        (self.folder / "bin/dynrt").write_text("a program")
        self.config = {
            "folder": str(self.folder),
            "proofs": {"units": ["add", "mul"]},
            "mutants": {"mutants": 10, "seeds": [1], "units": ["tpu", "update"], "least": 80},
        }

    def leave(self, path, result, suffix=".json", **other):
        job = self.plan.find(path)
        program = program_of(job.command, self.folder / "bin")
        left = {"command": job.command, "program": program, "seconds": 60, "result": result, **other}
        file = self.folder / f"{path}{suffix}"
        file.parent.mkdir(exist_ok=True)
        file.write_text(json.dumps(left))

    def found(self):
        return report.report(jobs.Plan(self.config))

    def finish(self, noticed=9):
        self.plan = jobs.Plan(self.config)
        for unit in ("add", "mul"):
            self.leave(f"proofs/{unit}", {"proofs": [{"holds": True}] * 3})
        for unit in ("tpu", "update"):
            result = {"drawn": 11, "noticed": noticed, "equivalent": 1, "survived": 10 - noticed, "seed": 1, "mutants": []}
            self.leave(f"mutants/{unit}-seed1", result)

    def test_all_done(self):
        self.finish()
        found = self.found()
        self.assertTrue(found["complete"])
        self.assertEqual(found["parts"]["proofs"]["figures"], {"proofs": 6, "hold": 6})
        self.assertIn("22 mutants: 18 killed (90.0 %), 2 equivalent, 2 survived", report.to_text(found))
        self.assertIn("4 of 4 jobs done, 0 failed, 0 missing", report.to_markdown(found))

    def test_too_few_noticed(self):
        self.finish(noticed=7)
        found = self.found()
        self.assertFalse(found["complete"])
        self.assertIn("failed checks: mutants", report.to_text(found))
        self.assertEqual(found["parts"]["mutants"]["figures"]["noticed_percent"], 70)

    def test_a_proof_that_does_not_hold(self):
        self.finish()
        self.leave("proofs/add", {"proofs": [{"holds": True}, {"holds": False}]})
        self.assertIn("1 of 5 proofs do not hold", report.to_text(self.found()))

    def test_missing_and_failed(self):
        self.finish()
        (self.folder / "proofs/mul.json").unlink()
        (self.folder / "mutants/tpu-seed1.json").unlink()
        self.leave("mutants/tpu-seed1", {"last": ["error: no"]}, ".failed", why="ended with status 1")
        found = self.found()
        self.assertFalse(found["complete"])
        text = report.to_text(found)
        self.assertIn("MISSING proofs/mul\n", text)
        self.assertIn("FAILED mutants/tpu-seed1: ended with status 1: error: no\n", text)
        self.assertIn("2 of 4 jobs done, 1 failed, 1 missing", text)

    def test_another_program(self):
        self.finish()
        (self.folder / "bin/dynrt").write_text("another program")
        self.assertIn("0 of 4 jobs done, 0 failed, 4 missing", report.to_text(self.found()))

    def test_another_command(self):
        self.finish()
        self.config["mutants"]["mutants"] = 20
        text = report.to_text(self.found())
        self.assertIn("MISSING mutants/tpu-seed1: the result belongs to another program or another command", text)

    def test_a_file_that_was_cut_off(self):
        self.finish()
        (self.folder / "proofs/mul.json").write_text('{"command": [')
        self.assertIn("MISSING proofs/mul\n", report.to_text(self.found()))

    def test_no_jobs(self):
        self.finish()
        self.config["proofs"]["units"] = []
        found = self.found()
        self.assertFalse(found["complete"])
        self.assertEqual(found["parts"]["proofs"]["fault"], "a part without jobs")

    def test_nothing_counted(self):
        self.finish()
        for unit in ("add", "mul"):
            self.leave(f"proofs/{unit}", {"proofs": []})
        self.assertEqual(self.found()["parts"]["proofs"]["fault"], "no proofs")

    def test_no_parts(self):
        self.config = {"folder": str(self.folder)}
        self.assertFalse(self.found()["complete"])

    def test_a_part_that_does_not_exist(self):
        self.config["prooofs"] = {}
        with self.assertRaisesRegex(jobs.Mistake, "prooofs"):
            self.found()


class Tests(unittest.TestCase):
    def test_all_that_were_asked_for_must_pass(self):
        said = "test a ... ok\ntest result: {}. {} passed; {} failed; 0 ignored\n"
        self.assertEqual(read_tests(said.format("ok", 2, 0), ["a", "b"])["passed"], 2)
        for outcome, passed, failed in (("ok", 1, 0), ("FAILED", 1, 1), ("ok", 0, 0)):
            with self.assertRaises(ValueError):
                read_tests(said.format(outcome, passed, failed), ["a", "b"])
        with self.assertRaises(ValueError):
            read_tests("", ["a"])
        self.assertEqual(read_tests(said.format("ok", 3, 0) + said.format("ok", 0, 0), [])["passed"], 3)
        with self.assertRaises(ValueError):
            read_tests(said.format("ok", 0, 0), [])


if __name__ == "__main__":
    unittest.main()
