"""ros2_medkit, a gateway to robots with the shape of SOVD (ISO 17978): its faults are evidence, its restart
is an action.

    faults.py      faults and the statuses they make (pure)     gateway.py     its HTTP
    restart.py     the action                                   feed.py        the section `medkit:`
"""
