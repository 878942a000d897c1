"""Who is told that a person is needed: by a signed call, or by mail.

    event log ──► notices.py: are people told of it? ──► store/notifications.py, per recipient
                                                                                    │
                       robomend.webhooks, SMTP ◄── delivery.py ◄── notifier.py: what is due, again and again

recipients.py     whom the settings name, and what each is told of
notices.py        events to notices, and notices to sentences
delivery.py       one message to one recipient
notifier.py       the task that writes down what is to be told, and sends it
"""
