;; reset_usb.pddl: a device without a power channel comes back when its USB bus is reset.
;;
;; Everything on the bus is reset, so every driver of it must restart.
;; Use it as a robot's `domain`; say who carries it out under `actions`: docs/repair.md.

(define (domain robot-repair)
  (:types bus - object)
  (:predicates
    (on_bus ?h - hardware ?b - bus))    ; static
  (:action reset_usb
    :parameters (?b - bus)
    :precondition (exists (?h - hardware) (and (on_bus ?h ?b) (bad ?h)))
    :effect (and
      (forall (?h - hardware) (when (on_bus ?h ?b) (and (good ?h) (not (bad ?h)))))
      (forall (?h - hardware ?n - node)
        (when (and (on_bus ?h ?b) (drives ?n ?h)) (and (bad ?n) (not (good ?n)))))
      (increase (total-cost) 5)))
  (:objects usb1 - bus)
  (:init (on_bus imu usb1)))
