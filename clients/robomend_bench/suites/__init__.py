"""The suites, one a file; `robomend_bench.suite` says what one is and how to add one."""
