;; switch_to_spare.pddl: hardware reconfiguration, the paper's second kind of hardware repair.
;;
;; A robot with two laser scanners, both powered; one driver reads one of them. When the driver's restart does
;; not bring the first one's scans back, it is pointed at the second and restarted.
;;
;; Its names are those of examples/two_lidars.yaml. Use it as a robot's `domain`; say who carries it out
;; under `actions`: docs/repair.md.

(define (domain robot-repair)
  (:predicates
    (spare_for ?s ?h - hardware))       ; static: ?s can stand in for ?h
  ;; (good ?h) then means that the robot has what it had ?h for. A power cycle (29) helps
  ;; every other time, so that 30 puts this before it: docs/repair.md, "What was tried, and quarantine".
  (:action switch_to_spare
    :parameters (?h ?s - hardware)
    :precondition (and (spare_for ?s ?h) (bad ?h) (good ?s) (on ?s))
    :effect (and (good ?h) (not (bad ?h))
      (forall (?n - node) (when (drives ?n ?h) (and (bad ?n) (not (good ?n)))))
      (increase (total-cost) 30)))
  (:init (spare_for lidar_b lidar)))
