"""Tests of Nav2's interfaces, by clients that call them as Nav2's own clients do."""
