"""The line of waiting tickets, and the batch that stands at its head."""

from __future__ import annotations

from typing import Any

from anchorflow_service.planning.job import Ticket

AnyTicket = Ticket[Any]


class WaitingLine:
    """Tickets in the order in which they came; not safe to share between threads by itself."""

    def __init__(self) -> None:
        self._tickets: list[AnyTicket] = []

    def count(self) -> int:
        """Tickets that still wait for something."""
        return sum(not ticket.has_ended for ticket in self._tickets)

    @property
    def first(self) -> AnyTicket | None:
        """The oldest, where there is one."""
        return self._tickets[0] if self._tickets else None

    def add(self, ticket: AnyTicket) -> None:
        """At the end."""
        self._tickets.append(ticket)

    def discard(self, ticket: AnyTicket) -> None:
        """Take it out, if it still stands in the line."""
        if ticket in self._tickets:
            self._tickets.remove(ticket)

    def batch(self, most: int) -> list[AnyTicket]:
        """The oldest ticket and, up to `most` in all, those of its key that wait behind it.

        They stay in the line. Tickets that have ended leave it, and those whose budget is spent
        end here: no time goes into them.
        """
        self._tickets = [ticket for ticket in self._tickets if _still_counts(ticket)]
        if not self._tickets:
            return []
        first, *others = self._tickets
        alike = [other for other in others if first.key is not None and other.key == first.key]
        return [first, *alike[: most - 1]]

    def remove(self, batch: list[AnyTicket]) -> None:
        """Take a batch out."""
        self._tickets = [ticket for ticket in self._tickets if ticket not in batch]

    def clear(self) -> list[AnyTicket]:
        """Take out all."""
        tickets, self._tickets = self._tickets, []
        return tickets


def _still_counts(ticket: AnyTicket) -> bool:
    if ticket.budget_ms is not None and not ticket.arrival.left_ms(ticket.budget_ms):
        ticket.run_out()
    return not ticket.has_ended
