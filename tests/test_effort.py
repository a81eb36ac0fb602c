"""The measure of effort sees work that is done one by one."""

from tests.effort import calls_for_each


def test_work_in_bulk_costs_nothing_for_each_and_work_one_by_one_does():
    assert calls_for_each(lambda count: lambda: sum(range(count))) == 0.0
    assert calls_for_each(lambda count: lambda: [abs(n) for n in range(count)]) >= 1.0
