CREATE TABLE public.agent_actions (
    number bigint NOT NULL,
    id text NOT NULL COLLATE pg_catalog."C",
    robot text NOT NULL COLLATE pg_catalog."C",
    host text COLLATE pg_catalog."C",
    name text NOT NULL COLLATE pg_catalog."C",
    parameters text NOT NULL COLLATE pg_catalog."C",
    timeout_s double precision NOT NULL,
    queued_ns bigint NOT NULL,
    expires_ns bigint NOT NULL,
    taken_by text COLLATE pg_catalog."C",
    taken_ns bigint,
    answered boolean NOT NULL,
    code bigint,
    message text NOT NULL COLLATE pg_catalog."C",
    settled_ns bigint
);
CREATE SEQUENCE public.agent_actions_number_seq
    START WITH 1
    INCREMENT BY 1
    NO MINVALUE
    NO MAXVALUE
    CACHE 1;
ALTER SEQUENCE public.agent_actions_number_seq OWNED BY public.agent_actions.number;
CREATE TABLE public.alembic_version (
    version_num character varying(32) NOT NULL
);
CREATE TABLE public.api_keys (
    number bigint NOT NULL,
    id text NOT NULL COLLATE pg_catalog."C",
    name text NOT NULL COLLATE pg_catalog."C",
    hash text NOT NULL COLLATE pg_catalog."C",
    role text NOT NULL COLLATE pg_catalog."C",
    robot text COLLATE pg_catalog."C",
    created_ns bigint NOT NULL,
    by text NOT NULL COLLATE pg_catalog."C",
    revoked_ns bigint
);
CREATE SEQUENCE public.api_keys_number_seq
    START WITH 1
    INCREMENT BY 1
    NO MINVALUE
    NO MAXVALUE
    CACHE 1;
ALTER SEQUENCE public.api_keys_number_seq OWNED BY public.api_keys.number;
CREATE TABLE public.assertions (
    robot text NOT NULL COLLATE pg_catalog."C",
    name text NOT NULL COLLATE pg_catalog."C",
    sentence text NOT NULL COLLATE pg_catalog."C",
    source text NOT NULL COLLATE pg_catalog."C",
    time_ns bigint NOT NULL,
    expires_ns bigint
);
CREATE TABLE public.attempts (
    number bigint NOT NULL,
    robot text NOT NULL COLLATE pg_catalog."C",
    component text NOT NULL COLLATE pg_catalog."C",
    repair text NOT NULL COLLATE pg_catalog."C",
    time_ns bigint NOT NULL
);
CREATE SEQUENCE public.attempts_number_seq
    START WITH 1
    INCREMENT BY 1
    NO MINVALUE
    NO MAXVALUE
    CACHE 1;
ALTER SEQUENCE public.attempts_number_seq OWNED BY public.attempts.number;
CREATE TABLE public.audit (
    id bigint NOT NULL,
    time_ns bigint NOT NULL,
    actor text NOT NULL COLLATE pg_catalog."C",
    action text NOT NULL COLLATE pg_catalog."C",
    subject text NOT NULL COLLATE pg_catalog."C",
    robot text COLLATE pg_catalog."C",
    reason text NOT NULL COLLATE pg_catalog."C",
    before text COLLATE pg_catalog."C",
    after text COLLATE pg_catalog."C"
);
CREATE TABLE public.batch_jobs (
    number bigint NOT NULL,
    id text NOT NULL COLLATE pg_catalog."C",
    place text NOT NULL COLLATE pg_catalog."C",
    state text NOT NULL COLLATE pg_catalog."C",
    open boolean NOT NULL,
    data text NOT NULL COLLATE pg_catalog."C",
    created_ns bigint NOT NULL,
    updated_ns bigint NOT NULL
);
CREATE SEQUENCE public.batch_jobs_number_seq
    START WITH 1
    INCREMENT BY 1
    NO MINVALUE
    NO MAXVALUE
    CACHE 1;
ALTER SEQUENCE public.batch_jobs_number_seq OWNED BY public.batch_jobs.number;
CREATE TABLE public.counters (
    name text NOT NULL COLLATE pg_catalog."C",
    value bigint NOT NULL
);
CREATE TABLE public.drills (
    number bigint NOT NULL,
    id text NOT NULL COLLATE pg_catalog."C",
    robot text NOT NULL COLLATE pg_catalog."C",
    state text NOT NULL COLLATE pg_catalog."C",
    open boolean NOT NULL,
    watched boolean NOT NULL,
    asked text COLLATE pg_catalog."C",
    data text NOT NULL COLLATE pg_catalog."C",
    created_ns bigint NOT NULL,
    updated_ns bigint NOT NULL
);
CREATE SEQUENCE public.drills_number_seq
    START WITH 1
    INCREMENT BY 1
    NO MINVALUE
    NO MAXVALUE
    CACHE 1;
ALTER SEQUENCE public.drills_number_seq OWNED BY public.drills.number;
CREATE TABLE public.events (
    id bigint NOT NULL,
    time_ns bigint NOT NULL,
    kind text NOT NULL COLLATE pg_catalog."C",
    robot text COLLATE pg_catalog."C",
    revision bigint,
    batch text COLLATE pg_catalog."C",
    data text COLLATE pg_catalog."C",
    common bigint
);
CREATE TABLE public.idempotency (
    number bigint NOT NULL,
    digest bytea NOT NULL,
    request bytea NOT NULL,
    response text NOT NULL COLLATE pg_catalog."C",
    expires_ns bigint NOT NULL
);
CREATE SEQUENCE public.idempotency_number_seq
    START WITH 1
    INCREMENT BY 1
    NO MINVALUE
    NO MAXVALUE
    CACHE 1;
ALTER SEQUENCE public.idempotency_number_seq OWNED BY public.idempotency.number;
CREATE TABLE public.instances (
    id text NOT NULL COLLATE pg_catalog."C",
    host text NOT NULL COLLATE pg_catalog."C",
    pid integer NOT NULL,
    started_ns bigint NOT NULL,
    heartbeat_ns bigint NOT NULL
);
CREATE TABLE public.journal (
    number bigint NOT NULL,
    id text NOT NULL COLLATE pg_catalog."C",
    repair text NOT NULL COLLATE pg_catalog."C",
    step integer NOT NULL,
    robot text NOT NULL COLLATE pg_catalog."C",
    name text NOT NULL COLLATE pg_catalog."C",
    parameters text NOT NULL COLLATE pg_catalog."C",
    timeout_s double precision NOT NULL,
    fence bigint NOT NULL,
    intended_ns bigint NOT NULL,
    code bigint,
    message text NOT NULL COLLATE pg_catalog."C",
    settled_ns bigint
);
CREATE SEQUENCE public.journal_number_seq
    START WITH 1
    INCREMENT BY 1
    NO MINVALUE
    NO MAXVALUE
    CACHE 1;
ALTER SEQUENCE public.journal_number_seq OWNED BY public.journal.number;
CREATE TABLE public.model_versions (
    name text NOT NULL COLLATE pg_catalog."C",
    number integer NOT NULL,
    version text NOT NULL COLLATE pg_catalog."C",
    format text NOT NULL COLLATE pg_catalog."C",
    source text NOT NULL COLLATE pg_catalog."C",
    created_ns bigint NOT NULL,
    by text NOT NULL COLLATE pg_catalog."C"
);
CREATE TABLE public.models (
    name text NOT NULL COLLATE pg_catalog."C",
    current integer NOT NULL
);
CREATE TABLE public.notifications (
    number bigint NOT NULL,
    recipient text NOT NULL COLLATE pg_catalog."C",
    key text NOT NULL COLLATE pg_catalog."C",
    data text NOT NULL COLLATE pg_catalog."C",
    created_ns bigint NOT NULL,
    tries integer NOT NULL,
    due_ns bigint,
    state text NOT NULL COLLATE pg_catalog."C",
    answer text NOT NULL COLLATE pg_catalog."C"
);
CREATE SEQUENCE public.notifications_number_seq
    START WITH 1
    INCREMENT BY 1
    NO MINVALUE
    NO MAXVALUE
    CACHE 1;
ALTER SEQUENCE public.notifications_number_seq OWNED BY public.notifications.number;
CREATE TABLE public.obs (
    robot text NOT NULL COLLATE pg_catalog."C",
    atom text NOT NULL COLLATE pg_catalog."C",
    positive boolean NOT NULL,
    source text NOT NULL COLLATE pg_catalog."C",
    time_ns bigint NOT NULL,
    expires_ns bigint,
    since_ns bigint,
    onset_ns bigint,
    settled bigint,
    revision bigint DEFAULT '0'::bigint NOT NULL,
    more text COLLATE pg_catalog."C"
);
CREATE TABLE public.quarantine (
    robot text NOT NULL COLLATE pg_catalog."C",
    component text NOT NULL COLLATE pg_catalog."C",
    reason text NOT NULL COLLATE pg_catalog."C",
    failures integer NOT NULL,
    since_ns bigint NOT NULL,
    until_ns bigint
);
CREATE TABLE public.repair_requests (
    number bigint NOT NULL,
    repair text NOT NULL COLLATE pg_catalog."C",
    robot text NOT NULL COLLATE pg_catalog."C",
    what text NOT NULL COLLATE pg_catalog."C",
    by text NOT NULL COLLATE pg_catalog."C",
    reason text NOT NULL COLLATE pg_catalog."C",
    time_ns bigint NOT NULL,
    done boolean NOT NULL
);
CREATE SEQUENCE public.repair_requests_number_seq
    START WITH 1
    INCREMENT BY 1
    NO MINVALUE
    NO MAXVALUE
    CACHE 1;
ALTER SEQUENCE public.repair_requests_number_seq OWNED BY public.repair_requests.number;
CREATE TABLE public.repair_steps (
    repair text NOT NULL COLLATE pg_catalog."C",
    step integer NOT NULL,
    state text NOT NULL COLLATE pg_catalog."C",
    data text NOT NULL COLLATE pg_catalog."C",
    updated_ns bigint NOT NULL
);
CREATE TABLE public.repairs (
    number bigint NOT NULL,
    id text NOT NULL COLLATE pg_catalog."C",
    robot text NOT NULL COLLATE pg_catalog."C",
    state text NOT NULL COLLATE pg_catalog."C",
    open boolean NOT NULL,
    data text NOT NULL COLLATE pg_catalog."C",
    created_ns bigint NOT NULL,
    updated_ns bigint NOT NULL
);
CREATE SEQUENCE public.repairs_number_seq
    START WITH 1
    INCREMENT BY 1
    NO MINVALUE
    NO MAXVALUE
    CACHE 1;
ALTER SEQUENCE public.repairs_number_seq OWNED BY public.repairs.number;
CREATE TABLE public.results (
    number bigint NOT NULL,
    digest bytea NOT NULL,
    used_day integer NOT NULL,
    data bytea NOT NULL
);
CREATE SEQUENCE public.results_number_seq
    START WITH 1
    INCREMENT BY 1
    NO MINVALUE
    NO MAXVALUE
    CACHE 1;
ALTER SEQUENCE public.results_number_seq OWNED BY public.results.number;
CREATE TABLE public.robot_state (
    robot text NOT NULL COLLATE pg_catalog."C",
    revision bigint NOT NULL,
    fence bigint NOT NULL,
    owner text COLLATE pg_catalog."C",
    folded bigint DEFAULT '0'::bigint NOT NULL
);
CREATE TABLE public.robots (
    id text NOT NULL COLLATE pg_catalog."C",
    config text NOT NULL COLLATE pg_catalog."C",
    etag text NOT NULL COLLATE pg_catalog."C",
    model text COLLATE pg_catalog."C",
    created_ns bigint NOT NULL,
    updated_ns bigint NOT NULL
);
CREATE TABLE public.settings (
    name text NOT NULL COLLATE pg_catalog."C",
    value text NOT NULL COLLATE pg_catalog."C"
);
CREATE TABLE public.sign_ins (
    hash text NOT NULL COLLATE pg_catalog."C",
    key text NOT NULL COLLATE pg_catalog."C",
    created_ns bigint NOT NULL,
    expires_ns bigint NOT NULL
);
CREATE TABLE public.start_ups (
    robot text NOT NULL COLLATE pg_catalog."C",
    topic text NOT NULL COLLATE pg_catalog."C",
    took text NOT NULL COLLATE pg_catalog."C"
);
CREATE TABLE public.tried (
    number bigint NOT NULL,
    robot text NOT NULL COLLATE pg_catalog."C",
    bad text NOT NULL COLLATE pg_catalog."C",
    actions text NOT NULL COLLATE pg_catalog."C",
    helped boolean NOT NULL,
    effect_seen boolean NOT NULL,
    repair text COLLATE pg_catalog."C",
    time_ns bigint NOT NULL,
    data text NOT NULL COLLATE pg_catalog."C"
);
CREATE SEQUENCE public.tried_number_seq
    START WITH 1
    INCREMENT BY 1
    NO MINVALUE
    NO MAXVALUE
    CACHE 1;
ALTER SEQUENCE public.tried_number_seq OWNED BY public.tried.number;
ALTER TABLE ONLY public.agent_actions ALTER COLUMN number SET DEFAULT nextval('public.agent_actions_number_seq'::regclass);
ALTER TABLE ONLY public.api_keys ALTER COLUMN number SET DEFAULT nextval('public.api_keys_number_seq'::regclass);
ALTER TABLE ONLY public.attempts ALTER COLUMN number SET DEFAULT nextval('public.attempts_number_seq'::regclass);
ALTER TABLE ONLY public.batch_jobs ALTER COLUMN number SET DEFAULT nextval('public.batch_jobs_number_seq'::regclass);
ALTER TABLE ONLY public.drills ALTER COLUMN number SET DEFAULT nextval('public.drills_number_seq'::regclass);
ALTER TABLE ONLY public.idempotency ALTER COLUMN number SET DEFAULT nextval('public.idempotency_number_seq'::regclass);
ALTER TABLE ONLY public.journal ALTER COLUMN number SET DEFAULT nextval('public.journal_number_seq'::regclass);
ALTER TABLE ONLY public.notifications ALTER COLUMN number SET DEFAULT nextval('public.notifications_number_seq'::regclass);
ALTER TABLE ONLY public.repair_requests ALTER COLUMN number SET DEFAULT nextval('public.repair_requests_number_seq'::regclass);
ALTER TABLE ONLY public.repairs ALTER COLUMN number SET DEFAULT nextval('public.repairs_number_seq'::regclass);
ALTER TABLE ONLY public.results ALTER COLUMN number SET DEFAULT nextval('public.results_number_seq'::regclass);
ALTER TABLE ONLY public.tried ALTER COLUMN number SET DEFAULT nextval('public.tried_number_seq'::regclass);
INSERT INTO public.agent_actions VALUES (2, 'a:2', 'r1', NULL, 'stop_node', '["x"]', 1000000000, 1795323609353635667, 2795323609353635667, NULL, NULL, false, NULL, '', NULL);
INSERT INTO public.agent_actions VALUES (1, 'a:1', 'r1', 'nuc', 'start_node', '["hokuyo_node"]', 2.5, 1795323609353635667, 1795323611853635667, NULL, NULL, true, 3, 'no', 1795323609353635667);
INSERT INTO public.alembic_version VALUES ('1');
INSERT INTO public.api_keys VALUES (2, 'k-nj2hybxmrj', 'admin', 'h2', 'admin', NULL, 1795323609353635667, 'command line', NULL);
INSERT INTO public.api_keys VALUES (1, 'k-3mcma99dtt', 'robot-r1', 'h1', 'robot', 'r1', 1795323609353635667, 'ada', 1795323609353635667);
INSERT INTO public.assertions VALUES ('r1', 'night', 'ok(scan) or ok(odom)', 'ada', 1763800000000000000, NULL);
INSERT INTO public.attempts VALUES (1, 'r1', 'hokuyo', 'r-cnzhf9xsb8', 1795323609353635667);
INSERT INTO public.audit VALUES (1, 1795323609315295307, 'ada', 'robot.put', 'r1', 'r1', 'first', NULL, '{"model":"tedusar"}');
INSERT INTO public.audit VALUES (2, 1795323609353635667, 'ada', 'stop.set', 'all robots', NULL, 'smoke', '{"active":false}', '{"active":true}');
INSERT INTO public.batch_jobs VALUES (1, 'b-7k2m9x4q', '/var/lib/robomend/batches', 'waiting', true, '{"model":"tedusar","source":"upload","files":["night.bag"],"by":"local"}', 1795409102806262425, 1795409102806262425);
INSERT INTO public.counters VALUES ('audit', 2);
INSERT INTO public.counters VALUES ('event', 21);
INSERT INTO public.drills VALUES (1, 'd-rhb9dr877h', 'r1', 'waiting', true, false, NULL, '{"fault":"node-killed"}', 1795368500615647274, 1795368500615647274);
INSERT INTO public.events VALUES (8, 1796000001000000000, 'observations', 'r8', 2, '{"b":"robot-r8","e":[["ok",["scan"],false,"general",1796000000999999995]]}', NULL, NULL);
INSERT INTO public.events VALUES (6, 1796000000000000000, 'observations', 'r8', 1, '{"b":"robot-r8","e":[["ok",["scan"],true,"general",1795999999999999995],["ok",["odom"],true,"general",1795999999999999995]]}', NULL, NULL);
INSERT INTO public.events VALUES (3, 1795323609349105878, 'observations', 'gone', 1, '{"e":[["ok",["x"],true,"general",1763800000000000000,null]]}', NULL, NULL);
INSERT INTO public.events VALUES (2, 1795323609345766325, 'observations', 'r1', 2, '{"e":[["ok",["odom"],true,"general",1763800000000000000,null]]}', NULL, NULL);
INSERT INTO public.events VALUES (9, 1796000001000000000, 'diagnosis', 'r8', 2, NULL, '{"revision":2,
,"elapsed_s":0.0005}}', 3);
INSERT INTO public.events VALUES (7, 1796000000000000000, 'diagnosis', 'r8', 1, NULL, '{"revision":1,
,"elapsed_s":0.0005}}', 2);
INSERT INTO public.events VALUES (5, 1795406360111025727, 'diagnosis', 'r1', 2, NULL, '{"revision":2,
}', 1);
INSERT INTO public.events VALUES (4, 1795368500615647274, 'diagnosis', 'r1', 2, NULL, '{"revision":2,"model_version":"v1","fault":null,"expected_stopped":[],"result":{"diagnoses":[{"bad":["hokuyo"],"good":["jaguar"],"probability":0.5,"modes":{},"resolves":[0],"text":"\u00e9: \u222a"}],"complete":true,"stopped_by":null,"conflicts":[],"conflicts_complete":true,"learned":[],"cleared":{},"unused":[],"unexplored":0,"factored":[],"count":1,"elapsed_s":0.000321}}', NULL);
INSERT INTO public.events VALUES (1, 1795323609334200674, 'diagnosis', 'r1', 1, NULL, '{"diagnoses":[{"bad":["hokuyo_node"],"good":[]}],"complete":true}', NULL);
INSERT INTO public.events VALUES (10, 1796086401000000000, 'observations', 'r8', 3, '{"b":"robot-r8","e":[["ok",["scan"],true,"general",1796086400999999995]]}', '{"revision":3,"changed":["ok(scan)"],"forgotten":[],"accepted_ns":1796086400999600000}', NULL);
INSERT INTO public.events VALUES (12, 1796086401000000000, 'observations', 'r8', 4, '{"b":"robot-r8","e":[["ok",["odom"],false,"general",1796086400999999995]]}', '{"revision":4,"changed":["not ok(odom)"],"forgotten":[],"accepted_ns":1796086400999600000}', NULL);
INSERT INTO public.events VALUES (15, 1796086401000000000, 'observations', 'r8', 5, '{"b":"robot-r8","e":[["ok",["odom"],true,"general",1796086400999999995]]}', '{"revision":5,"changed":["ok(odom)"],"forgotten":[],"accepted_ns":1796086400999600000}', NULL);
INSERT INTO public.events VALUES (17, 1796086402000000000, 'observations', 'r8', 6, '{"b":"robot-r8","e":[["inc",["odom_yaw"],true,"general",1796086401999999991,1796087402000000000,1796086401900000000,1796086401900000000,3]]}', '{"revision":6,"changed":["inc(odom_yaw)","not dec(odom_yaw)","not const(odom_yaw)"],"forgotten":[],"accepted_ns":1796086401999600000}', NULL);
INSERT INTO public.events VALUES (14, 1796086401000000000, 'observations', 'r9', 1, '{"b":"robot-r8","e":[["ok",["odom"],false,"general",1796086400999999995]]}', '{"revision":1,"changed":["not ok(odom)"],"forgotten":[],"accepted_ns":1796086400999600000}', NULL);
INSERT INTO public.events VALUES (18, 1796086403000000000, 'observations', 'r9', 2, '{"b":"ada","e":[["ok",["map"],true,"general",1796086402999999995]],"a":[["night","ok(map) or ok(scan)","ada",1796086403000000000,null]]}', '{"revision":2,"changed":["ok(map)"],"forgotten":["ok(odom)"],"accepted_ns":1796086402999600000}', NULL);
INSERT INTO public.events VALUES (20, 1796086404000000000, 'observations', 'r9', 3, '{"b":"ada","e":[],"w":["night"]}', '{"revision":3,"changed":[],"forgotten":[],"accepted_ns":1796086403999600000}', NULL);
INSERT INTO public.events VALUES (21, 1796086404000000000, 'robot', 'r9', NULL, NULL, '{"etag":"x","what":"updated"}', NULL);
INSERT INTO public.events VALUES (11, 1796086401000000000, 'diagnosis', 'r8', 3, NULL, '{"revision":3,
,"elapsed_s":0.0005}}', 2);
INSERT INTO public.events VALUES (13, 1796086401000000000, 'diagnosis', 'r8', 4, NULL, '{"revision":4,
,"elapsed_s":0.0005}}', 4);
INSERT INTO public.events VALUES (16, 1796086401000000000, 'diagnosis', 'r8', 5, NULL, '{"revision":5,
,"elapsed_s":0.0005}}', 2);
INSERT INTO public.events VALUES (19, 1796086404000000000, 'diagnosis', 'r9', 2, NULL, '{"revision":2,
,"elapsed_s":0.0005}}', 6);
INSERT INTO public.idempotency VALUES (1, '\xc2387338712d427a82ca9254f14af983', '\x5555bf542ec8581b3ed4443271b62cc4', '1', 2795323609334200674);
INSERT INTO public.instances VALUES ('9a79531e7ba67f57', 'nuc', 31253, 1795323609314879124, 1795323609315295307);
INSERT INTO public.instances VALUES ('705108d6b49d3332', 'nuc', 21219, 1795368500606828367, 1795368500611051857);
INSERT INTO public.instances VALUES ('0733ed9189c3a345', 'nuc', 26916, 1795406360106591212, 1795406360107444020);
INSERT INTO public.journal VALUES (1, 'a:0', 'r-cnzhf9xsb8', 0, 'r1', 'power_up', '["hokuyo"]', 5, 1, 1795323609353635667, 0, 'ok', 1795323609353635667);
INSERT INTO public.journal VALUES (2, 'a:1', 'r-cnzhf9xsb8', 1, 'r1', 'start_node', '["hokuyo_node"]', 2.5, 1, 1795323609353635667, NULL, '', NULL);
INSERT INTO public.model_versions VALUES ('tedusar', 1, '9fcb9bae577bb5fac4c7', 'component', '# The TEDUSAR search and rescue robot: the running example of the paper (sections III and IV-D).
# Schemes 1 to 5 give 18 clauses. No rule can blame imu and joystick: `robomend model check` says so.
robomend: 1
name: tedusar
channels: 10
protected_channels: [2]               # feeds the robot''s own computer, which is no component
hardware:
  jaguar: {channel: 7}                # the tracked base', 1795323609315295307, 'ada');
INSERT INTO public.model_versions VALUES ('lamp', 1, '79345a2ca2c4db3d5147', 'component', 'robomend: 1
name: lamp
hardware: {lamp: {channel: 1}}
', 1795323609315295307, 'ada');
INSERT INTO public.model_versions VALUES ('lamp', 2, '6d935a216bfca57be72e', 'component', 'robomend: 1
name: lamp
hardware: {lamp: {channel: 2}}
', 1795323609315295307, 'bob');
INSERT INTO public.models VALUES ('tedusar', 1);
INSERT INTO public.models VALUES ('lamp', 2);
INSERT INTO public.notifications VALUES (1, 'ops', 'robot unknown r1', '{"what":"robot unknown"}', 1795368500615647274, 0, 1795368500615647274, 'waiting', '');
INSERT INTO public.obs VALUES ('r1', '["ok","scan"]', false, 'general', 1763800000000000000, NULL, NULL, NULL, NULL, 0, NULL);
INSERT INTO public.obs VALUES ('r1', '["running","hokuyo_node"]', true, 'general', 1763800000000000000, 1763800001000000000, NULL, NULL, NULL, 0, NULL);
INSERT INTO public.obs VALUES ('r1', '["matched","odom_yaw","imu_yaw"]', true, 'general', 1763800000000000000, NULL, NULL, NULL, NULL, 0, NULL);
INSERT INTO public.obs VALUES ('r1', '["ok","odom"]', true, 'general', 1763800000000000000, NULL, NULL, NULL, NULL, 0, NULL);
INSERT INTO public.obs VALUES ('r8', '["ok","scan"]', true, 'general', 1796086400999999995, NULL, NULL, NULL, NULL, 0, NULL);
INSERT INTO public.obs VALUES ('r8', '["ok","odom"]', true, 'general', 1796086400999999995, NULL, NULL, NULL, NULL, 0, NULL);
INSERT INTO public.obs VALUES ('r8', '["dec","odom_yaw"]', false, 'general', 1796086401999999991, 1796087402000000000, 1796086401900000000, 1796086401900000000, 3, 0, NULL);
INSERT INTO public.obs VALUES ('r8', '["const","odom_yaw"]', false, 'general', 1796086401999999991, 1796087402000000000, 1796086401900000000, 1796086401900000000, 3, 0, NULL);
INSERT INTO public.obs VALUES ('r8', '["inc","odom_yaw"]', true, 'general', 1796086403000000000, 1796087403000000000, 1796086402999999990, NULL, NULL, 0, NULL);
INSERT INTO public.obs VALUES ('r9', '["ok","map"]', true, 'general', 1796086402999999995, NULL, NULL, NULL, NULL, 0, NULL);
INSERT INTO public.quarantine VALUES ('r1', 'hokuyo', 'three times', 3, 1763800000000000000, NULL);
INSERT INTO public.quarantine VALUES ('r1', 'imu', 'once', 1, 1763800000000000000, 1763800000000000005);
INSERT INTO public.repair_requests VALUES (1, 'r-cnzhf9xsb8', 'r1', 'approve', 'ada', 'yes', 1795323609353635667, false);
INSERT INTO public.repair_requests VALUES (2, 'r-cnzhf9xsb8', 'r1', 'cancel', 'bob', 'smoke', 1795323609353635667, true);
INSERT INTO public.repair_steps VALUES ('r-cnzhf9xsb8', 0, 'done', '{"seen":["on(hokuyo)"]}', 1795323609353635667);
INSERT INTO public.repair_steps VALUES ('r-cnzhf9xsb8', 1, 'running', '{}', 1795323609353635667);
INSERT INTO public.repairs VALUES (1, 'r-fjmxj2dnre', 'r1', 'done', false, '{"diagnosis":{"bad":["hokuyo_node"]}}', 1795323609353635667, 1795323609353635667);
INSERT INTO public.repairs VALUES (2, 'r-cnzhf9xsb8', 'r1', 'executing', true, '{"plan":[],"\u00e9":"\u222a"}', 1795323609353635667, 1795323609353635667);
INSERT INTO public.results VALUES (1, '\x8d9025e81fb39e09079ba12d081810b6', 20780, '\x789c4d8d3b0e83301404efb2b5ab94be4a842c833704e5e167f9838210778ff329d2ee8c76b06aa0b88db92c1a61b15d6070f34d2a6c6c22067c264e95c195aa2931c05e0783ccf2710e84c5cf510b4b070746ff1670d747db155d9c55ff16177b0fc3d9c1a46b1256c2d6dc68f0bb77e3fe2d9f2fbbea3734');
INSERT INTO public.results VALUES (3, '\xaa8d2a13274acd363c2ee3ee6b56cf12', 20787, '\x789c358e490ec2301004ffd2679f38fa2b288abc4c8261e2b1ec714484f83b49806b7549d55824128f2bd59624c362bdc060729d15367766037a160a4a716c2aa55084bd0e0695dae9bc10939bb3346afbf0827787809b3cfa26d8c559e424773777570f52aa78e71327ddbe8df70e832c854909566b27835f6cf4dbff47903c710a7a74860f3aba40ba');
INSERT INTO public.results VALUES (4, '\x0227aa676ad022ff2a4248d9c26593f5', 20788, '\x789c5d8e490ac3301004ffd2679d72d45782315ac64666ac11d2c8c498fc3d76964baed505d55825128f1bd59624c362bbc160729d15367766037a140a4a716c2aa55084bd0f0695dadb3910939bb3346ae770c0bb4bc0e2e6ee2a4e7116f923a58a773e71d2fdd3789e30c85a989460b57632f8c646bfff7e04c913a7a0576778012d414095');
INSERT INTO public.results VALUES (2, '\xbcfbd1c9d2aaf651cdc453378e76e0ca', 20788, '\x789c358e4b0e83301043efe275565de62a1542f90c2868c844c90415a1debd40dba5ed273d6395483c6e545b920c8bed0183c97556d8dc990de8552828c5b1a9944211f63918546a37732026376769d4cee1807717802c997062b3c89d17377757afa654f1ce274eba7f0defb30cb216262558ad9d0c7eaad1efff1741f2c429e865193ea50e3fcb');
INSERT INTO public.results VALUES (6, '\x358dc9baff151e9c9f4b7f3008cf619e', 20788, '\x789c358e490ac3301004ffd2679d72d45782315ac64661ac11d2c8c498fc3d5e926b7541351689c4e34ab525c9b0581f30985c6785cd9dd980de8582521c9b4a2914619f8341a576393b6272739646ed187678770ae0145dc5e1cd221778b9b9dfa454f1ce274ebadd89cf01832c854909566b27835f6bf4dbff46903c710a7a66862fe5ab4027');
INSERT INTO public.robot_state VALUES ('r2', 0, 0, NULL, 0);
INSERT INTO public.robot_state VALUES ('r1', 2, 1, '9a79531e7ba67f57', 2);
INSERT INTO public.robot_state VALUES ('gone', 1, 0, NULL, 1);
INSERT INTO public.robot_state VALUES ('r8', 6, 0, NULL, 6);
INSERT INTO public.robot_state VALUES ('r9', 3, 0, NULL, 3);
INSERT INTO public.robots VALUES ('r1', '{"model":"tedusar","policy":"approve"}', '4b4f4c52a3fd251fd62c', 'tedusar', 1795323609315295307, 1795323609315295307);
INSERT INTO public.robots VALUES ('r2', '{"model":"lamp","policy":"auto","name":"\u00e9\u222a"}', '8424276af761f4c37c26', 'lamp', 1795323609315295307, 1795323609315295307);
INSERT INTO public.robots VALUES ('r8', '{"model":"tedusar"}', 'be3c798a21af630b8fdb', 'tedusar', 1796000000000000000, 1796000000000000000);
INSERT INTO public.robots VALUES ('r9', '{"model":"tedusar"}', 'be3c798a21af630b8fdb', 'tedusar', 1796000000000000000, 1796000000000000000);
INSERT INTO public.settings VALUES ('stop', '{"active":true,"by":"ada","reason":"smoke","since_ns":1795323609353635667}');
INSERT INTO public.sign_ins VALUES ('cookie', 'k-nj2hybxmrj', 1795323609353635667, 4611686018427387904);
INSERT INTO public.start_ups VALUES ('r8', 'scan', '[2000000000]');
INSERT INTO public.tried VALUES (1, 'r1', '["hokuyo"]', '["power_up(hokuyo)"]', false, true, 'r-fjmxj2dnre', 1763800000000000000, '{"note":1}');
SELECT pg_catalog.setval('public.agent_actions_number_seq', 2, true);
SELECT pg_catalog.setval('public.api_keys_number_seq', 2, true);
SELECT pg_catalog.setval('public.attempts_number_seq', 1, true);
SELECT pg_catalog.setval('public.batch_jobs_number_seq', 1, true);
SELECT pg_catalog.setval('public.drills_number_seq', 1, true);
SELECT pg_catalog.setval('public.idempotency_number_seq', 1, true);
SELECT pg_catalog.setval('public.journal_number_seq', 2, true);
SELECT pg_catalog.setval('public.notifications_number_seq', 1, true);
SELECT pg_catalog.setval('public.repair_requests_number_seq', 2, true);
SELECT pg_catalog.setval('public.repairs_number_seq', 2, true);
SELECT pg_catalog.setval('public.results_number_seq', 6, true);
SELECT pg_catalog.setval('public.tried_number_seq', 1, true);
ALTER TABLE ONLY public.agent_actions
    ADD CONSTRAINT agent_actions_id_key UNIQUE (id);
ALTER TABLE ONLY public.agent_actions
    ADD CONSTRAINT agent_actions_pkey PRIMARY KEY (number);
ALTER TABLE ONLY public.alembic_version
    ADD CONSTRAINT alembic_version_pkey PRIMARY KEY (version_num);
ALTER TABLE ONLY public.api_keys
    ADD CONSTRAINT api_keys_hash_key UNIQUE (hash);
ALTER TABLE ONLY public.api_keys
    ADD CONSTRAINT api_keys_id_key UNIQUE (id);
ALTER TABLE ONLY public.api_keys
    ADD CONSTRAINT api_keys_pkey PRIMARY KEY (number);
ALTER TABLE ONLY public.assertions
    ADD CONSTRAINT assertions_pkey PRIMARY KEY (robot, name);
ALTER TABLE ONLY public.attempts
    ADD CONSTRAINT attempts_pkey PRIMARY KEY (number);
ALTER TABLE ONLY public.audit
    ADD CONSTRAINT audit_pkey PRIMARY KEY (id);
ALTER TABLE ONLY public.batch_jobs
    ADD CONSTRAINT batch_jobs_id_key UNIQUE (id);
ALTER TABLE ONLY public.batch_jobs
    ADD CONSTRAINT batch_jobs_pkey PRIMARY KEY (number);
ALTER TABLE ONLY public.counters
    ADD CONSTRAINT counters_pkey PRIMARY KEY (name);
ALTER TABLE ONLY public.drills
    ADD CONSTRAINT drills_id_key UNIQUE (id);
ALTER TABLE ONLY public.drills
    ADD CONSTRAINT drills_pkey PRIMARY KEY (number);
ALTER TABLE ONLY public.events
    ADD CONSTRAINT events_pkey PRIMARY KEY (id);
ALTER TABLE ONLY public.idempotency
    ADD CONSTRAINT idempotency_digest_key UNIQUE (digest);
ALTER TABLE ONLY public.idempotency
    ADD CONSTRAINT idempotency_pkey PRIMARY KEY (number);
ALTER TABLE ONLY public.instances
    ADD CONSTRAINT instances_pkey PRIMARY KEY (id);
ALTER TABLE ONLY public.journal
    ADD CONSTRAINT journal_id_key UNIQUE (id);
ALTER TABLE ONLY public.journal
    ADD CONSTRAINT journal_pkey PRIMARY KEY (number);
ALTER TABLE ONLY public.model_versions
    ADD CONSTRAINT model_versions_pkey PRIMARY KEY (name, number);
ALTER TABLE ONLY public.models
    ADD CONSTRAINT models_pkey PRIMARY KEY (name);
ALTER TABLE ONLY public.notifications
    ADD CONSTRAINT notifications_pkey PRIMARY KEY (number);
ALTER TABLE ONLY public.obs
    ADD CONSTRAINT obs_pkey PRIMARY KEY (robot, atom);
ALTER TABLE ONLY public.quarantine
    ADD CONSTRAINT quarantine_pkey PRIMARY KEY (robot, component);
ALTER TABLE ONLY public.repair_requests
    ADD CONSTRAINT repair_requests_pkey PRIMARY KEY (number);
ALTER TABLE ONLY public.repair_steps
    ADD CONSTRAINT repair_steps_pkey PRIMARY KEY (repair, step);
ALTER TABLE ONLY public.repairs
    ADD CONSTRAINT repairs_id_key UNIQUE (id);
ALTER TABLE ONLY public.repairs
    ADD CONSTRAINT repairs_pkey PRIMARY KEY (number);
ALTER TABLE ONLY public.results
    ADD CONSTRAINT results_digest_key UNIQUE (digest);
ALTER TABLE ONLY public.results
    ADD CONSTRAINT results_pkey PRIMARY KEY (number);
ALTER TABLE ONLY public.robot_state
    ADD CONSTRAINT robot_state_pkey PRIMARY KEY (robot);
ALTER TABLE ONLY public.robots
    ADD CONSTRAINT robots_pkey PRIMARY KEY (id);
ALTER TABLE ONLY public.settings
    ADD CONSTRAINT settings_pkey PRIMARY KEY (name);
ALTER TABLE ONLY public.sign_ins
    ADD CONSTRAINT sign_ins_pkey PRIMARY KEY (hash);
ALTER TABLE ONLY public.start_ups
    ADD CONSTRAINT start_ups_pkey PRIMARY KEY (robot, topic);
ALTER TABLE ONLY public.tried
    ADD CONSTRAINT tried_pkey PRIMARY KEY (number);
CREATE INDEX ix_agent_actions_waiting ON public.agent_actions USING btree (robot) WHERE (settled_ns IS NULL);
CREATE INDEX ix_attempts_robot ON public.attempts USING btree (robot, time_ns);
CREATE INDEX ix_audit_robot ON public.audit USING btree (robot, id);
CREATE INDEX ix_batch_jobs_open ON public.batch_jobs USING btree (place) WHERE open;
CREATE INDEX ix_drills_open ON public.drills USING btree (robot) WHERE open;
CREATE INDEX ix_drills_robot ON public.drills USING btree (robot, number);
CREATE INDEX ix_events_robot ON public.events USING btree (robot, kind, id);
CREATE INDEX ix_journal_repair ON public.journal USING btree (repair);
CREATE INDEX ix_journal_unsettled ON public.journal USING btree (robot) WHERE (settled_ns IS NULL);
CREATE INDEX ix_notifications_due ON public.notifications USING btree (due_ns) WHERE (due_ns IS NOT NULL);
CREATE INDEX ix_notifications_key ON public.notifications USING btree (key, recipient);
CREATE INDEX ix_repair_requests_open ON public.repair_requests USING btree (robot) WHERE (NOT done);
CREATE INDEX ix_repair_requests_repair ON public.repair_requests USING btree (repair);
CREATE INDEX ix_repairs_open ON public.repairs USING btree (robot) WHERE open;
CREATE INDEX ix_repairs_robot ON public.repairs USING btree (robot, number);
CREATE INDEX ix_results_used_day ON public.results USING btree (used_day);
CREATE INDEX ix_robot_state_owner ON public.robot_state USING btree (owner);
CREATE INDEX ix_robots_model ON public.robots USING btree (model);
CREATE INDEX ix_sign_ins_key ON public.sign_ins USING btree (key);
CREATE INDEX ix_tried_robot ON public.tried USING btree (robot, number);
