;; repair.pddl: bring bad components back by switching power and restarting processes.
;;
;; Problems come from service/robomend/planning/problem.py:
;;   init   OBS completed, bad and good of one diagnosis; exactly one of each pair holds;
;;          what is stopped or off is bad; what is stopped and may still be there lingers
;;   goal   (good ?c) for each component that is meant to work
;;
;; Conventions
;;   A fact and its opposite (on/off, running/stopped, bad/good) are two predicates, and an action
;;   that adds one deletes the other: tests/pddl/test_repair_domain.py.
;;   forall and when are guarded by static predicates only, so that grounding leaves STRIPS.
;;   An action is one command of service/robomend/repairs/execution.py, with the same name; mend is sent as
;;   the act that its remedy is, clear_costmap(planner). Costs are about seconds: what a repair takes before
;;   its effect can be seen.
;;
;; Why it is larger than the paper's four actions (paper-repair.pddl)
;;   A device that comes back from a power cycle leaves its driver holding a dead connection: the driver
;;   turns bad and must be restarted, unless it reconnects. A node is only started once what it rests on is
;;   good, and nothing of it is left from before.
;;   A user's own actions are merged in: docs/planning.md, "Your own actions".

(define (domain robot-repair)
  (:requirements :strips :typing :adl :action-costs)
  (:types component remedy - object     ; a remedy: an act of the model's `remedies`, such as a service call
          hardware node - component)    ; a device, a process
  (:predicates
    (bad ?c - component)                ; blamed by the diagnosis under repair, or about to be
    (good ?c - component)               ; expected to work; the next diagnosis decides
    (on ?h - hardware) (off ?h - hardware)
    (running ?n - node) (stopped ?n - node)
    (lingers ?n - node)                 ; stopped, by what is observed, and not known to have ended
    ;; static from here
    (switchable ?h - hardware)          ; has a channel of the power board
    (restartable ?n - node)
    (drives ?n - node ?h - hardware)
    (loses ?n - node ?h - hardware)     ; n drives h, and its connection is dead once h was off
    (fed_by ?h - hardware ?p - hardware)   ; or by what feeds that, up the chain
    (hangs_on ?h - hardware ?p - hardware) ; fed by it, and without a channel of its own
    (needs ?n - node ?m - node)         ; m must be good before n starts
    (tied ?n - node ?m - node)          ; n must restart after m restarts
    (mends ?r - remedy ?c - component)
    (asks ?r - remedy ?n - node)        ; n must run to be mended by it …
    (begins ?r - remedy ?n - node)      ; … or is started by it, as by the restart of a unit
    (rests_on ?r - remedy ?c - component) ; c must be good before, or it helps nothing
    (upsets ?r - remedy ?n - node))     ; n must restart after it
  (:functions (total-cost) - number)

  ;; The driver of a device that comes back must reconnect, hence restart. What hangs on it comes back with it;
  ;; so does what it feeds through a channel of its own whose relay stayed where it was; one that was opened
  ;; is closed by itself, after the supply.
  (:action power_up
    :parameters (?h - hardware)
    :precondition (and (switchable ?h) (off ?h)
      (forall (?p - hardware) (imply (fed_by ?h ?p) (good ?p))))
    :effect (and (on ?h) (not (off ?h)) (good ?h) (not (bad ?h))
      (forall (?n - node) (when (loses ?n ?h) (and (bad ?n) (not (good ?n)))))
      (forall (?d - hardware) (when (hangs_on ?d ?h) (and (good ?d) (not (bad ?d)))))
      (forall (?d - hardware ?n - node)
        (when (and (fed_by ?d ?h) (loses ?n ?d)) (and (bad ?n) (not (good ?n)))))
      (increase (total-cost) 10)))

  ;; Only what is blamed is switched off: a plan never darkens a device that works.
  (:action shutdown
    :parameters (?h - hardware)
    :precondition (and (switchable ?h) (on ?h) (bad ?h))
    :effect (and (off ?h) (not (on ?h))
      (forall (?n - node) (when (loses ?n ?h) (and (bad ?n) (not (good ?n)))))
      (forall (?d - hardware) (when (hangs_on ?d ?h) (and (bad ?d) (not (good ?d)))))
      (increase (total-cost) 15)))

  (:action start_node
    :parameters (?n - node)
    :precondition (and (restartable ?n) (stopped ?n) (not (lingers ?n))
      (forall (?h - hardware) (imply (drives ?n ?h) (good ?h)))
      (forall (?m - node) (imply (needs ?n ?m) (good ?m))))
    :effect (and (running ?n) (not (stopped ?n)) (good ?n) (not (bad ?n))
      (increase (total-cost) 3)))

  ;; Only what is blamed is stopped. A driver turns bad when its device's power comes back, so that is waited
  ;; for: a relay that is stuck does not cost a node its life. A process that is halted, or of which nothing is
  ;; heard, is stopped like one that runs: to start it would find it there.
  (:action stop_node
    :parameters (?n - node)
    :precondition (and (restartable ?n) (or (and (lingers ?n) (stopped ?n)) (running ?n)) (bad ?n))
    :effect (and (stopped ?n) (not (running ?n)) (not (lingers ?n)) (bad ?n) (not (good ?n))
      (forall (?m - node) (when (tied ?m ?n) (and (bad ?m) (not (good ?m)))))
      (increase (total-cost) 1)))

  ;; Whatever the model offers besides: a service is called, a parameter set, a lifecycle brought up again. It is
  ;; done for what is blamed, and takes nothing away.
  (:action mend
    :parameters (?r - remedy)
    :precondition (and (exists (?c - component) (and (mends ?r ?c) (bad ?c)))
      (forall (?h - hardware) (imply (mends ?r ?h) (on ?h)))
      (forall (?n - node) (imply (asks ?r ?n) (running ?n)))
      (forall (?c - component) (imply (rests_on ?r ?c) (good ?c))))
    :effect (and
      (forall (?c - component) (when (mends ?r ?c) (and (good ?c) (not (bad ?c)))))
      (forall (?n - node)
        (when (begins ?r ?n) (and (running ?n) (not (stopped ?n)) (not (lingers ?n)))))
      (forall (?n - node) (when (upsets ?r ?n) (and (bad ?n) (not (good ?n)))))
      (increase (total-cost) 2))))
