"""The adapter's envelope, whatever it is answered."""

import os
import random
import sys
import unittest

sys.path.insert(0, os.path.join(os.path.dirname(__file__), "..", "..", "deploy", "linuxcnc"))
from feedwright_adapter import Envelope  # noqa: E402


class Story(unittest.TestCase):
    def setUp(self):
        self.envelope = Envelope(20.0, 150.0)
        self.now = 100.0

    def wait(self, seconds):
        applied = None
        for _ in range(round(seconds / 0.01)):
            self.now += 0.01
            applied = self.envelope.step(self.now)
        return applied

    def answer(self, percent, valid_for_ms=500, overload=False):
        return self.envelope.answer(self.now, percent, valid_for_ms, overload)

    def test_what_cannot_be_true_is_never_applied(self):
        for wrong in (-1, 0, 3.0, 19.9, 150.1, float("nan"), float("inf"), "100", None, True, [100]):
            self.assertFalse(self.answer(wrong), wrong)
            self.assertEqual(self.wait(0.1), 100.0)
        for wrong in (-1, float("nan"), None, 1e9):
            self.assertFalse(self.answer(50.0, wrong), wrong)
            self.assertEqual(self.wait(0.1), 100.0)

    def test_down_at_once_and_up_by_five_points_a_period(self):
        self.wait(0.1)
        self.assertTrue(self.answer(40.0))
        self.assertEqual(self.wait(0.01), 40.0)
        self.assertTrue(self.answer(140.0))
        self.assertAlmostEqual(self.wait(0.01), 45.0)
        self.assertAlmostEqual(self.wait(0.1), 95.0)

    def test_without_answers_it_goes_back_to_100(self):
        self.wait(0.1)
        self.answer(40.0, 200)
        self.assertEqual(self.wait(0.19), 40.0)
        self.assertAlmostEqual(self.wait(0.3), 100.0)
        self.answer(140.0, 200)
        self.wait(0.15)
        self.assertEqual(self.wait(0.1), 100.0, "from above at once")

    def test_it_never_goes_up_while_an_overload_is_not_acknowledged(self):
        self.wait(0.1)
        self.answer(40.0, 200, overload=True)
        self.assertEqual(self.wait(2.0), 40.0)
        self.envelope.begin()
        self.assertEqual(self.wait(0.1), 100.0, "the next cycle starts at 100")

    def test_hold_holds(self):
        self.envelope = Envelope(20.0, 150.0, on_loss="hold")
        self.wait(0.1)
        self.answer(40.0, 200)
        self.assertEqual(self.wait(2.0), 40.0)

    def test_no_answers_whatever_leave_the_limits_or_rise_too_fast(self):
        chance = random.Random(5)
        pick = [-1, 3.0, float("nan"), float("inf"), -0.0, None, "x", 20, 60.0, 100, 149.9, 150, 1e300]
        before = 100.0
        for _ in range(50_000):
            if chance.random() < 0.2:
                valid = chance.choice([0, 100, 500, -5, float("nan"), None])
                self.answer(chance.choice(pick), valid, chance.choice([True, False, None]))
            if chance.random() < 0.01:
                self.envelope.begin()
                before = 100.0
            self.now += chance.choice([0.0, 0.005, 0.01, 0.02])
            applied = self.envelope.step(self.now)
            self.assertTrue(20.0 <= applied <= 150.0)
            self.assertLessEqual(applied, before + 500.0 * 0.02 + 1e-9)
            before = applied


if __name__ == "__main__":
    unittest.main()
