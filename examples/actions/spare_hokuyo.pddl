;; spare_hokuyo.pddl: the second scanner of examples/tedusar_spare.yaml takes the place of the first.
;;
;; switch_to_spare.pddl has the idea. `robomend demo --scenario dead-lidar` plays it; there, the robot's agent
;; carries it out: clients/robomend_demo/spare.py.

(define (domain robot-repair)
  (:predicates
    (spare_for ?s ?h - hardware))       ; static: ?s can stand in for ?h
  (:action switch_to_spare
    :parameters (?h ?s - hardware)
    :precondition (and (spare_for ?s ?h) (bad ?h) (good ?s) (on ?s))
    :effect (and (good ?h) (not (bad ?h))
      (forall (?n - node) (when (drives ?n ?h) (and (bad ?n) (not (good ?n)))))
      (increase (total-cost) 70)))      ; dear: after a power cycle, which costs 29 and helps every other time
  (:init (spare_for hokuyo_b hokuyo)))
