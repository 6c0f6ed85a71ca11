"""Beliefs kept alike on robots that meet only now and then (DPRWA): exchange, the time ring, what it costs."""
