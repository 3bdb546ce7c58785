"""Metrics, traces and logs of the service.

metrics  counts, durations and load, for Prometheus
logs     log lines as text or JSON, one per HTTP exchange
spans    OpenTelemetry spans; imported only with `--traces`
"""
