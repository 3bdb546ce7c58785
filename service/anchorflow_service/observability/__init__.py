"""What the service tells of itself: metrics, traces and logs.

metrics     counts and durations, as Prometheus reads them
collector   what is read off the service at the moment of asking
exchanges   HTTP requests and what became of them
spans       OpenTelemetry spans; imported only where they are asked for
logs        one line a record, as text or as JSON
"""
