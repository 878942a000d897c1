; A driver must have released its device before the bus is reset: let_go stops it although it is well.
(define (domain robot-repair)
  (:types bus - object)
  (:predicates (on_bus ?h - hardware ?b - bus))
  (:action let_go                       ; as stop_node, of a driver that is well
    :parameters (?n - node)
    :precondition (and (running ?n) (exists (?h - hardware) (and (drives ?n ?h) (bad ?h))))
    :effect (and (stopped ?n) (not (running ?n)) (bad ?n) (not (good ?n)) (increase (total-cost) 1)))
  (:action reset_usb
    :parameters (?b - bus)
    :precondition (and
      (exists (?h - hardware) (and (on_bus ?h ?b) (bad ?h)))
      (forall (?h - hardware ?n - node) (imply (and (on_bus ?h ?b) (drives ?n ?h)) (stopped ?n))))
    :effect (and
      (forall (?h - hardware) (when (on_bus ?h ?b) (and (good ?h) (not (bad ?h)))))
      (increase (total-cost) 5)))
  (:objects usb1 - bus)
  (:init (on_bus imu usb1)))
