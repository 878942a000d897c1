BEGIN TRANSACTION;
CREATE TABLE agent_actions (
	number INTEGER NOT NULL PRIMARY KEY AUTOINCREMENT,
	id TEXT NOT NULL,
	robot TEXT NOT NULL,
	host TEXT,
	name TEXT NOT NULL,
	parameters TEXT NOT NULL,
	timeout_s FLOAT NOT NULL,
	queued_ns BIGINT NOT NULL,
	expires_ns BIGINT NOT NULL,
	taken_by TEXT,
	taken_ns BIGINT,
	answered BOOLEAN NOT NULL,
	code BIGINT,
	message TEXT NOT NULL,
	settled_ns BIGINT,
	UNIQUE (id)
);
INSERT INTO "agent_actions" VALUES(1,'a:1','r1','nuc','start_node','["hokuyo_node"]',2.5,1795323608154951947,1795323610654951947,NULL,NULL,1,3,'no',1795323608154951947);
INSERT INTO "agent_actions" VALUES(2,'a:2','r1',NULL,'stop_node','["x"]',1000000000.0,1795323608154951947,2795323608154951947,NULL,NULL,0,NULL,'',NULL);
CREATE TABLE alembic_version (
	version_num VARCHAR(32) NOT NULL,
	PRIMARY KEY (version_num)
);
INSERT INTO "alembic_version" VALUES('0007');
CREATE TABLE api_keys (
	number INTEGER NOT NULL PRIMARY KEY AUTOINCREMENT,
	id TEXT NOT NULL,
	name TEXT NOT NULL,
	hash TEXT NOT NULL,
	role TEXT NOT NULL,
	robot TEXT,
	created_ns BIGINT NOT NULL,
	"by" TEXT NOT NULL,
	revoked_ns BIGINT,
	UNIQUE (id),
	UNIQUE (hash)
);
INSERT INTO "api_keys" VALUES(1,'k-n7cb4a4y5e','robot-r1','h1','robot','r1',1795323608154951947,'ada',1795323608154951947);
INSERT INTO "api_keys" VALUES(2,'k-ns9jn8bgex','admin','h2','admin',NULL,1795323608154951947,'command line',NULL);
CREATE TABLE assertions (
	robot TEXT NOT NULL,
	name TEXT NOT NULL,
	sentence TEXT NOT NULL,
	source TEXT NOT NULL,
	time_ns BIGINT NOT NULL,
	expires_ns BIGINT,
	PRIMARY KEY (robot, name)
)
 WITHOUT ROWID
;
INSERT INTO "assertions" VALUES('r1','night','ok(scan) or ok(odom)','ada',1763800000000000000,NULL);
CREATE TABLE attempts (
	number INTEGER NOT NULL PRIMARY KEY AUTOINCREMENT,
	robot TEXT NOT NULL,
	component TEXT NOT NULL,
	repair TEXT NOT NULL,
	time_ns BIGINT NOT NULL
);
INSERT INTO "attempts" VALUES(1,'r1','hokuyo','r-nyagmvzs5j',1795323608154951947);
CREATE TABLE audit (
	id INTEGER NOT NULL,
	time_ns BIGINT NOT NULL,
	actor TEXT NOT NULL,
	action TEXT NOT NULL,
	subject TEXT NOT NULL,
	robot TEXT,
	reason TEXT NOT NULL,
	"before" TEXT,
	"after" TEXT,
	PRIMARY KEY (id)
);
INSERT INTO "audit" VALUES(1,1795323608127488026,'ada','robot.put','r1','r1','first',NULL,'{"model":"tedusar"}');
INSERT INTO "audit" VALUES(2,1795323608154951947,'ada','stop.set','all robots',NULL,'smoke','{"active":false}','{"active":true}');
CREATE TABLE batch_jobs (
	number INTEGER NOT NULL PRIMARY KEY AUTOINCREMENT, 
	id TEXT NOT NULL, 
	place TEXT NOT NULL, 
	state TEXT NOT NULL, 
	open BOOLEAN NOT NULL, 
	data TEXT NOT NULL, 
	created_ns BIGINT NOT NULL, 
	updated_ns BIGINT NOT NULL, 
	UNIQUE (id)
);
INSERT INTO "batch_jobs" VALUES(1,'b-7k2m9x4q','/var/lib/robomend/batches','waiting',1,'{"model":"tedusar","source":"upload","files":["night.bag"],"by":"local"}',1795409102806262425,1795409102806262425);
CREATE TABLE counters (
	name TEXT NOT NULL,
	value BIGINT NOT NULL,
	PRIMARY KEY (name)
);
INSERT INTO "counters" VALUES('event',5);
INSERT INTO "counters" VALUES('audit',2);
CREATE TABLE diagnoses (
	number INTEGER NOT NULL PRIMARY KEY AUTOINCREMENT,
	robot TEXT NOT NULL,
	revision BIGINT NOT NULL,
	model_version TEXT NOT NULL,
	time_ns BIGINT NOT NULL,
	result TEXT NOT NULL
, common BIGINT);
INSERT INTO "diagnoses" VALUES(1,'r1',1,'abc',1795323608143673771,'{"diagnoses":[{"bad":["hokuyo_node"],"good":[]}],"complete":true}',NULL);
INSERT INTO "diagnoses" VALUES(2,'r1',2,'v1',1795368498801374728,'{"revision":2,"model_version":"v1","fault":null,"expected_stopped":[],"result":{"diagnoses":[{"bad":["hokuyo"],"good":["jaguar"],"probability":0.5,"modes":{},"resolves":[0],"text":"\u00e9: \u222a"}],"complete":true,"stopped_by":null,"conflicts":[],"conflicts_complete":true,"learned":[],"cleared":{},"unused":[],"unexplored":0,"factored":[],"count":1,"elapsed_s":0.000321}}',NULL);
INSERT INTO "diagnoses" VALUES(3,'r1',2,'v2',1795406357061802357,'{"revision":2,
}',1);
CREATE TABLE drills (
	number INTEGER NOT NULL PRIMARY KEY AUTOINCREMENT, 
	id TEXT NOT NULL, 
	robot TEXT NOT NULL, 
	state TEXT NOT NULL, 
	open BOOLEAN NOT NULL, 
	watched BOOLEAN NOT NULL, 
	asked TEXT, 
	data TEXT NOT NULL, 
	created_ns BIGINT NOT NULL, 
	updated_ns BIGINT NOT NULL, 
	UNIQUE (id)
);
INSERT INTO "drills" VALUES(1,'d-taj7vh55cf','r1','waiting',1,0,NULL,'{"fault":"node-killed"}',1795368498801374728,1795368498801374728);
CREATE TABLE events (
	id INTEGER NOT NULL,
	time_ns BIGINT NOT NULL,
	kind TEXT NOT NULL,
	robot TEXT,
	data TEXT NOT NULL, common BIGINT,
	PRIMARY KEY (id)
);
INSERT INTO "events" VALUES(1,1795323608143673771,'observations','r1','{"revision":1,"changed":["not ok(scan)"]}',NULL);
INSERT INTO "events" VALUES(2,1795323608143673771,'diagnosis','r1','{"diagnoses":[{"bad":["hokuyo_node"],"good":[]}]}',NULL);
INSERT INTO "events" VALUES(3,1795323608154951947,'stop',NULL,'{"active":true}',NULL);
INSERT INTO "events" VALUES(4,1795368498801374728,'diagnosis','r1','{"revision":2,"model_version":"v1","fault":null,"expected_stopped":[],"result":{"diagnoses":[{"bad":["hokuyo"],"good":["jaguar"],"probability":0.5,"modes":{},"resolves":[0],"text":"\u00e9: \u222a"}],"complete":true,"stopped_by":null,"conflicts":[],"conflicts_complete":true,"learned":[],"cleared":{},"unused":[],"unexplored":0,"factored":[],"count":1,"elapsed_s":0.000321}}',NULL);
INSERT INTO "events" VALUES(5,1795406357061802357,'diagnosis','r1','{"revision":2,
}',1);
CREATE TABLE idempotency (
	scope TEXT NOT NULL,
	"key" TEXT NOT NULL,
	request TEXT NOT NULL,
	response TEXT NOT NULL,
	expires_ns BIGINT NOT NULL,
	PRIMARY KEY (scope, "key")
);
INSERT INTO "idempotency" VALUES('ada POST /robots/r1/observations','key-1','digest','1',2795323608143673771);
CREATE TABLE instances (
	id TEXT NOT NULL,
	host TEXT NOT NULL,
	pid INTEGER NOT NULL,
	started_ns BIGINT NOT NULL,
	heartbeat_ns BIGINT NOT NULL,
	PRIMARY KEY (id)
);
INSERT INTO "instances" VALUES('a6b9d36b9dc3527c','nuc',31253,1795323608127039562,1795323608127488026);
INSERT INTO "instances" VALUES('39a13c222a17ba8c','nuc',26791,1795406356668802567,1795406357061802357);
CREATE TABLE journal (
	number INTEGER NOT NULL PRIMARY KEY AUTOINCREMENT,
	id TEXT NOT NULL,
	repair TEXT NOT NULL,
	step INTEGER NOT NULL,
	robot TEXT NOT NULL,
	name TEXT NOT NULL,
	parameters TEXT NOT NULL,
	timeout_s FLOAT NOT NULL,
	fence BIGINT NOT NULL,
	intended_ns BIGINT NOT NULL,
	code BIGINT,
	message TEXT NOT NULL,
	settled_ns BIGINT,
	UNIQUE (id)
);
INSERT INTO "journal" VALUES(1,'a:0','r-nyagmvzs5j',0,'r1','power_up','["hokuyo"]',5.0,1,1795323608154951947,0,'ok',1795323608154951947);
INSERT INTO "journal" VALUES(2,'a:1','r-nyagmvzs5j',1,'r1','start_node','["hokuyo_node"]',2.5,1,1795323608154951947,NULL,'',NULL);
CREATE TABLE model_versions (
	name TEXT NOT NULL,
	number INTEGER NOT NULL,
	version TEXT NOT NULL,
	format TEXT NOT NULL,
	source TEXT NOT NULL,
	created_ns BIGINT NOT NULL,
	"by" TEXT NOT NULL,
	PRIMARY KEY (name, number)
);
INSERT INTO "model_versions" VALUES('tedusar',1,'9fcb9bae577bb5fac4c7','component','# The TEDUSAR search and rescue robot: the running example of the paper (sections III and IV-D).
# Schemes 1 to 5 give 18 clauses. No rule can blame imu and joystick: `robomend model check` says so.
robomend: 1
name: tedusar
channels: 10
protected_channels: [2]               # feeds the robot''s own computer, which is no component
hardware:
  jaguar: {channel: 7}                # the tracked base',1795323608127488026,'ada');
INSERT INTO "model_versions" VALUES('lamp',1,'79345a2ca2c4db3d5147','component','robomend: 1
name: lamp
hardware: {lamp: {channel: 1}}
',1795323608127488026,'ada');
INSERT INTO "model_versions" VALUES('lamp',2,'6d935a216bfca57be72e','component','robomend: 1
name: lamp
hardware: {lamp: {channel: 2}}
',1795323608127488026,'bob');
CREATE TABLE models (
	name TEXT NOT NULL,
	current INTEGER NOT NULL,
	PRIMARY KEY (name)
);
INSERT INTO "models" VALUES('tedusar',1);
INSERT INTO "models" VALUES('lamp',2);
CREATE TABLE notifications (
	number INTEGER NOT NULL PRIMARY KEY AUTOINCREMENT, 
	recipient TEXT NOT NULL, 
	"key" TEXT NOT NULL, 
	data TEXT NOT NULL, 
	created_ns BIGINT NOT NULL, 
	tries INTEGER NOT NULL, 
	due_ns BIGINT, 
	state TEXT NOT NULL, 
	answer TEXT NOT NULL
);
INSERT INTO "notifications" VALUES(1,'ops','robot unknown r1','{"what":"robot unknown"}',1795368498801374728,0,1795368498801374728,'waiting','');
CREATE TABLE obs (
	robot TEXT NOT NULL,
	atom TEXT NOT NULL,
	positive BOOLEAN NOT NULL,
	source TEXT NOT NULL,
	time_ns BIGINT NOT NULL,
	expires_ns BIGINT, since_ns BIGINT, onset_ns BIGINT, settled BIGINT,
	PRIMARY KEY (robot, atom)
)
 WITHOUT ROWID
;
INSERT INTO "obs" VALUES('r1','["matched","odom_yaw","imu_yaw"]',1,'general',1763800000000000000,NULL,NULL,NULL,NULL);
INSERT INTO "obs" VALUES('r1','["ok","odom"]',1,'general',1763800000000000000,NULL,NULL,NULL,NULL);
INSERT INTO "obs" VALUES('r1','["ok","scan"]',0,'general',1763800000000000000,NULL,NULL,NULL,NULL);
INSERT INTO "obs" VALUES('r1','["running","hokuyo_node"]',1,'general',1763800000000000000,1763800001000000000,NULL,NULL,NULL);
CREATE TABLE observations (
	number INTEGER NOT NULL PRIMARY KEY AUTOINCREMENT,
	robot TEXT NOT NULL,
	revision BIGINT NOT NULL,
	time_ns BIGINT NOT NULL,
	data TEXT NOT NULL,
	CONSTRAINT uq_observations_robot_revision UNIQUE (robot, revision)
);
INSERT INTO "observations" VALUES(1,'r1',1,1795323608143673771,'{"e":[["ok",["scan"],false,"general",1763800000000000000,null],["on",["hokuyo"],true,"general",1763800000000000000,null],["running",["hokuyo_node"],true,"general",1763800000000000000,1763800001000000000],["matched",["odom_yaw","imu_yaw"],true,"general",1763800000000000000,null]],"a":[["night","ok(scan) or ok(odom)","ada",1763800000000000000,null]]}');
INSERT INTO "observations" VALUES(2,'r1',2,1795323608151179402,'{"e":[["ok",["odom"],true,"general",1763800000000000000,null]]}');
INSERT INTO "observations" VALUES(3,'gone',1,1795323608152733858,'{"e":[["ok",["x"],true,"general",1763800000000000000,null]]}');
CREATE TABLE quarantine (
	robot TEXT NOT NULL,
	component TEXT NOT NULL,
	reason TEXT NOT NULL,
	failures INTEGER NOT NULL,
	since_ns BIGINT NOT NULL,
	until_ns BIGINT,
	PRIMARY KEY (robot, component)
);
INSERT INTO "quarantine" VALUES('r1','hokuyo','three times',3,1763800000000000000,NULL);
INSERT INTO "quarantine" VALUES('r1','imu','once',1,1763800000000000000,1763800000000000005);
CREATE TABLE repair_requests (
	number INTEGER NOT NULL PRIMARY KEY AUTOINCREMENT,
	repair TEXT NOT NULL,
	robot TEXT NOT NULL,
	what TEXT NOT NULL,
	"by" TEXT NOT NULL,
	reason TEXT NOT NULL,
	time_ns BIGINT NOT NULL,
	done BOOLEAN NOT NULL
);
INSERT INTO "repair_requests" VALUES(1,'r-nyagmvzs5j','r1','approve','ada','yes',1795323608154951947,0);
INSERT INTO "repair_requests" VALUES(2,'r-nyagmvzs5j','r1','cancel','bob','smoke',1795323608154951947,1);
CREATE TABLE repair_steps (
	repair TEXT NOT NULL,
	step INTEGER NOT NULL,
	state TEXT NOT NULL,
	data TEXT NOT NULL,
	updated_ns BIGINT NOT NULL,
	PRIMARY KEY (repair, step)
);
INSERT INTO "repair_steps" VALUES('r-nyagmvzs5j',0,'done','{"seen":["on(hokuyo)"]}',1795323608154951947);
INSERT INTO "repair_steps" VALUES('r-nyagmvzs5j',1,'running','{}',1795323608154951947);
CREATE TABLE repairs (
	number INTEGER NOT NULL PRIMARY KEY AUTOINCREMENT,
	id TEXT NOT NULL,
	robot TEXT NOT NULL,
	state TEXT NOT NULL,
	open BOOLEAN NOT NULL,
	data TEXT NOT NULL,
	created_ns BIGINT NOT NULL,
	updated_ns BIGINT NOT NULL,
	UNIQUE (id)
);
INSERT INTO "repairs" VALUES(1,'r-rk29dxvwfm','r1','done',0,'{"diagnosis":{"bad":["hokuyo_node"]}}',1795323608154951947,1795323608154951947);
INSERT INTO "repairs" VALUES(2,'r-nyagmvzs5j','r1','executing',1,'{"plan":[],"\u00e9":"\u222a"}',1795323608154951947,1795323608154951947);
CREATE TABLE results (
	number INTEGER NOT NULL PRIMARY KEY AUTOINCREMENT, 
	digest BLOB NOT NULL, 
	used_day INTEGER NOT NULL, 
	data BLOB NOT NULL, 
	UNIQUE (digest)
);
INSERT INTO "results" VALUES(1,X'8D9025E81FB39E09079BA12D081810B6',20780,X'789C4D8D3B0E83301404EFB2B5AB94BE4A842C833704E5E167F9838210778FF329D2EE8C76B06AA0B88DB92C1A61B15D6070F34D2A6C6C22067C264E95C195AA2931C05E0783CCF2710E84C5CF510B4B070746FF1670D747DB155D9C55FF16177B0FC3D9C1A46B1256C2D6DC68F0BB77E3FE2D9F2FBBEA3734');
CREATE TABLE robot_state (
	robot TEXT NOT NULL,
	revision BIGINT NOT NULL,
	fence BIGINT NOT NULL,
	owner TEXT,
	PRIMARY KEY (robot)
);
INSERT INTO "robot_state" VALUES('r1',2,1,'a6b9d36b9dc3527c');
INSERT INTO "robot_state" VALUES('r2',0,0,NULL);
INSERT INTO "robot_state" VALUES('gone',1,0,NULL);
CREATE TABLE robots (
	id TEXT NOT NULL,
	config TEXT NOT NULL,
	etag TEXT NOT NULL,
	model TEXT,
	created_ns BIGINT NOT NULL,
	updated_ns BIGINT NOT NULL,
	PRIMARY KEY (id)
);
INSERT INTO "robots" VALUES('r1','{"model":"tedusar","policy":"approve"}','4b4f4c52a3fd251fd62c','tedusar',1795323608127488026,1795323608127488026);
INSERT INTO "robots" VALUES('r2','{"model":"lamp","policy":"auto","name":"\u00e9\u222a"}','8424276af761f4c37c26','lamp',1795323608127488026,1795323608127488026);
CREATE TABLE settings (
	name TEXT NOT NULL,
	value TEXT NOT NULL,
	PRIMARY KEY (name)
);
INSERT INTO "settings" VALUES('stop','{"active":true,"by":"ada","reason":"smoke","since_ns":1795323608154951947}');
CREATE TABLE sign_ins (
	hash TEXT NOT NULL,
	"key" TEXT NOT NULL,
	created_ns BIGINT NOT NULL,
	expires_ns BIGINT NOT NULL,
	PRIMARY KEY (hash)
);
INSERT INTO "sign_ins" VALUES('cookie','k-ns9jn8bgex',1795323608154951947,4611686018427387904);
CREATE TABLE tried (
	number INTEGER NOT NULL PRIMARY KEY AUTOINCREMENT,
	robot TEXT NOT NULL,
	bad TEXT NOT NULL,
	actions TEXT NOT NULL,
	helped BOOLEAN NOT NULL,
	effect_seen BOOLEAN NOT NULL,
	repair TEXT,
	time_ns BIGINT NOT NULL,
	data TEXT NOT NULL
);
INSERT INTO "tried" VALUES(1,'r1','["hokuyo"]','["power_up(hokuyo)"]',0,1,'r-rk29dxvwfm',1763800000000000000,'{"note":1}');
CREATE INDEX ix_robots_model ON robots (model);
CREATE INDEX ix_robot_state_owner ON robot_state (owner);
CREATE INDEX ix_diagnoses_robot ON diagnoses (robot, number);
CREATE INDEX ix_events_robot ON events (robot, id);
CREATE INDEX ix_audit_robot ON audit (robot, id);
CREATE INDEX ix_idempotency_expires ON idempotency (expires_ns);
CREATE INDEX ix_repairs_robot ON repairs (robot, number);
CREATE INDEX ix_repairs_open ON repairs (robot) WHERE open;
CREATE INDEX ix_repair_requests_open ON repair_requests (robot) WHERE NOT done;
CREATE INDEX ix_repair_requests_repair ON repair_requests (repair);
CREATE INDEX ix_journal_unsettled ON journal (robot) WHERE settled_ns IS NULL;
CREATE INDEX ix_journal_repair ON journal (repair);
CREATE INDEX ix_tried_robot ON tried (robot, number);
CREATE INDEX ix_attempts_robot ON attempts (robot, time_ns);
CREATE INDEX ix_sign_ins_key ON sign_ins ("key");
CREATE INDEX ix_agent_actions_waiting ON agent_actions (robot) WHERE settled_ns IS NULL;
CREATE INDEX ix_notifications_key ON notifications ("key", recipient);
CREATE INDEX ix_notifications_due ON notifications (due_ns) WHERE due_ns IS NOT NULL;
CREATE INDEX ix_drills_robot ON drills (robot, number);
CREATE INDEX ix_drills_open ON drills (robot) WHERE open;
CREATE INDEX ix_results_used_day ON results (used_day);
CREATE INDEX ix_batch_jobs_open ON batch_jobs (place) WHERE open;
DELETE FROM "sqlite_sequence";
INSERT INTO "sqlite_sequence" VALUES('observations',3);
INSERT INTO "sqlite_sequence" VALUES('diagnoses',3);
INSERT INTO "sqlite_sequence" VALUES('repairs',2);
INSERT INTO "sqlite_sequence" VALUES('repair_requests',2);
INSERT INTO "sqlite_sequence" VALUES('journal',2);
INSERT INTO "sqlite_sequence" VALUES('tried',1);
INSERT INTO "sqlite_sequence" VALUES('attempts',1);
INSERT INTO "sqlite_sequence" VALUES('agent_actions',2);
INSERT INTO "sqlite_sequence" VALUES('api_keys',2);
INSERT INTO "sqlite_sequence" VALUES('drills',1);
INSERT INTO "sqlite_sequence" VALUES('notifications',1);
INSERT INTO "sqlite_sequence" VALUES('results',1);
INSERT INTO "sqlite_sequence" VALUES('batch_jobs',1);
COMMIT;
