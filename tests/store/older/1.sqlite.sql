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
INSERT INTO "alembic_version" VALUES('1');
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
INSERT INTO "counters" VALUES('event',21);
INSERT INTO "counters" VALUES('audit',2);
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
CREATE TABLE "events" (
	id INTEGER NOT NULL, 
	time_ns BIGINT NOT NULL, 
	kind TEXT NOT NULL, 
	robot TEXT, 
	revision BIGINT, 
	batch TEXT, 
	data TEXT, 
	common BIGINT, 
	PRIMARY KEY (id)
);
INSERT INTO "events" VALUES(1,1795323608143673771,'diagnosis','r1',1,NULL,'{"diagnoses":[{"bad":["hokuyo_node"],"good":[]}],"complete":true}',NULL);
INSERT INTO "events" VALUES(2,1795323608151179402,'observations','r1',2,'{"e":[["ok",["odom"],true,"general",1763800000000000000,null]]}',NULL,NULL);
INSERT INTO "events" VALUES(3,1795323608152733858,'observations','gone',1,'{"e":[["ok",["x"],true,"general",1763800000000000000,null]]}',NULL,NULL);
INSERT INTO "events" VALUES(4,1795368498801374728,'diagnosis','r1',2,NULL,'{"revision":2,"model_version":"v1","fault":null,"expected_stopped":[],"result":{"diagnoses":[{"bad":["hokuyo"],"good":["jaguar"],"probability":0.5,"modes":{},"resolves":[0],"text":"\u00e9: \u222a"}],"complete":true,"stopped_by":null,"conflicts":[],"conflicts_complete":true,"learned":[],"cleared":{},"unused":[],"unexplored":0,"factored":[],"count":1,"elapsed_s":0.000321}}',NULL);
INSERT INTO "events" VALUES(5,1795406357061802357,'diagnosis','r1',2,NULL,'{"revision":2,
}',1);
INSERT INTO "events" VALUES(6,1796000000000000000,'observations','r8',1,'{"b":"robot-r8","e":[["ok",["scan"],true,"general",1795999999999999995],["ok",["odom"],true,"general",1795999999999999995]]}',NULL,NULL);
INSERT INTO "events" VALUES(7,1796000000000000000,'diagnosis','r8',1,NULL,'{"revision":1,
,"elapsed_s":0.0005}}',2);
INSERT INTO "events" VALUES(8,1796000001000000000,'observations','r8',2,'{"b":"robot-r8","e":[["ok",["scan"],false,"general",1796000000999999995]]}',NULL,NULL);
INSERT INTO "events" VALUES(9,1796000001000000000,'diagnosis','r8',2,NULL,'{"revision":2,
,"elapsed_s":0.0005}}',3);
INSERT INTO "events" VALUES(10,1796086401000000000,'observations','r8',3,'{"b":"robot-r8","e":[["ok",["scan"],true,"general",1796086400999999995]]}','{"revision":3,"changed":["ok(scan)"],"forgotten":[],"accepted_ns":1796086400999600000}',NULL);
INSERT INTO "events" VALUES(11,1796086401000000000,'diagnosis','r8',3,NULL,'{"revision":3,
,"elapsed_s":0.0005}}',2);
INSERT INTO "events" VALUES(12,1796086401000000000,'observations','r8',4,'{"b":"robot-r8","e":[["ok",["odom"],false,"general",1796086400999999995]]}','{"revision":4,"changed":["not ok(odom)"],"forgotten":[],"accepted_ns":1796086400999600000}',NULL);
INSERT INTO "events" VALUES(13,1796086401000000000,'diagnosis','r8',4,NULL,'{"revision":4,
,"elapsed_s":0.0005}}',4);
INSERT INTO "events" VALUES(14,1796086401000000000,'observations','r9',1,'{"b":"robot-r8","e":[["ok",["odom"],false,"general",1796086400999999995]]}','{"revision":1,"changed":["not ok(odom)"],"forgotten":[],"accepted_ns":1796086400999600000}',NULL);
INSERT INTO "events" VALUES(15,1796086401000000000,'observations','r8',5,'{"b":"robot-r8","e":[["ok",["odom"],true,"general",1796086400999999995]]}','{"revision":5,"changed":["ok(odom)"],"forgotten":[],"accepted_ns":1796086400999600000}',NULL);
INSERT INTO "events" VALUES(16,1796086401000000000,'diagnosis','r8',5,NULL,'{"revision":5,
,"elapsed_s":0.0005}}',2);
INSERT INTO "events" VALUES(17,1796086402000000000,'observations','r8',6,'{"b":"robot-r8","e":[["inc",["odom_yaw"],true,"general",1796086401999999991,1796087402000000000,1796086401900000000,1796086401900000000,3]]}','{"revision":6,"changed":["inc(odom_yaw)","not dec(odom_yaw)","not const(odom_yaw)"],"forgotten":[],"accepted_ns":1796086401999600000}',NULL);
INSERT INTO "events" VALUES(18,1796086403000000000,'observations','r9',2,'{"b":"ada","e":[["ok",["map"],true,"general",1796086402999999995]],"a":[["night","ok(map) or ok(scan)","ada",1796086403000000000,null]]}','{"revision":2,"changed":["ok(map)"],"forgotten":["ok(odom)"],"accepted_ns":1796086402999600000}',NULL);
INSERT INTO "events" VALUES(19,1796086404000000000,'diagnosis','r9',2,NULL,'{"revision":2,
,"elapsed_s":0.0005}}',6);
INSERT INTO "events" VALUES(20,1796086404000000000,'observations','r9',3,'{"b":"ada","e":[],"w":["night"]}','{"revision":3,"changed":[],"forgotten":[],"accepted_ns":1796086403999600000}',NULL);
INSERT INTO "events" VALUES(21,1796086404000000000,'robot','r9',NULL,NULL,'{"etag":"x","what":"updated"}',NULL);
CREATE TABLE idempotency (
	number INTEGER NOT NULL, 
	digest BLOB NOT NULL, 
	request BLOB NOT NULL, 
	response TEXT NOT NULL, 
	expires_ns BIGINT NOT NULL, 
	PRIMARY KEY (number), 
	UNIQUE (digest)
);
INSERT INTO "idempotency" VALUES(1,X'C2387338712D427A82CA9254F14AF983',X'5555BF542EC8581B3ED4443271B62CC4','1',2795323608143673771);
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
	expires_ns BIGINT, since_ns BIGINT, onset_ns BIGINT, settled BIGINT, revision BIGINT DEFAULT '0' NOT NULL, more TEXT,
	PRIMARY KEY (robot, atom)
)
 WITHOUT ROWID
;
INSERT INTO "obs" VALUES('r1','["matched","odom_yaw","imu_yaw"]',1,'general',1763800000000000000,NULL,NULL,NULL,NULL,0,NULL);
INSERT INTO "obs" VALUES('r1','["ok","odom"]',1,'general',1763800000000000000,NULL,NULL,NULL,NULL,0,NULL);
INSERT INTO "obs" VALUES('r1','["ok","scan"]',0,'general',1763800000000000000,NULL,NULL,NULL,NULL,0,NULL);
INSERT INTO "obs" VALUES('r1','["running","hokuyo_node"]',1,'general',1763800000000000000,1763800001000000000,NULL,NULL,NULL,0,NULL);
INSERT INTO "obs" VALUES('r8','["const","odom_yaw"]',0,'general',1796086401999999991,1796087402000000000,1796086401900000000,1796086401900000000,3,0,NULL);
INSERT INTO "obs" VALUES('r8','["dec","odom_yaw"]',0,'general',1796086401999999991,1796087402000000000,1796086401900000000,1796086401900000000,3,0,NULL);
INSERT INTO "obs" VALUES('r8','["inc","odom_yaw"]',1,'general',1796086403000000000,1796087403000000000,1796086402999999990,NULL,NULL,0,NULL);
INSERT INTO "obs" VALUES('r8','["ok","odom"]',1,'general',1796086400999999995,NULL,NULL,NULL,NULL,0,NULL);
INSERT INTO "obs" VALUES('r8','["ok","scan"]',1,'general',1796086400999999995,NULL,NULL,NULL,NULL,0,NULL);
INSERT INTO "obs" VALUES('r9','["ok","map"]',1,'general',1796086402999999995,NULL,NULL,NULL,NULL,0,NULL);
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
INSERT INTO "results" VALUES(2,X'BCFBD1C9D2AAF651CDC453378E76E0CA',20788,X'789C358E4B0E83301043EFE275565DE62A1542F90C2868C844C90415A1DEBD40DBA5ED273D6395483C6E545B920C8BED0183C97556D8DC990DE8552828C5B1A9944211F63918546A37732026376769D4CEE1807717802C997062B3C89D17377757AFA654F1CE274EBA7F0DEFB30CB216262558AD9D0C7EAAD1EFFF1741F2C429E865193EA50E3FCB');
INSERT INTO "results" VALUES(3,X'AA8D2A13274ACD363C2EE3EE6B56CF12',20787,X'789C358E490EC2301004FFD2679F38FA2B288ABC4C8261E2B1EC714484F83B49806B7549D55824128F2BD59624C362BDC060729D15367766037A160A4A716C2AA55084BD0E0695DAE9BC10939BB3346AFBF0827787809B3CFA26D8C559E424773777570F52AA78E71327DDBE8DF70E832C854909566B27835F6CF4DBFF47903C710A7A74860F3ABA40BA');
INSERT INTO "results" VALUES(4,X'0227AA676AD022FF2A4248D9C26593F5',20788,X'789C5D8E490AC3301004FFD2679D72D45782315AC64666AC11D2C8C498FC3D76964BAED505D55825128F1BD59624C362BBC160729D15367766037A140A4A716C2AA55084BD0F0695DADB3910939BB3346AE770C0BB4BC0E2E6EE2A4E7116F923A58A773E71D2FDD3789E30C85A989460B57632F8C646BFFF7E04C913A7A0576778012D414095');
INSERT INTO "results" VALUES(6,X'358DC9BAFF151E9C9F4B7F3008CF619E',20788,X'789C358E490AC3301004FFD2679D72D45782315AC64661AC11D2C8C498FC3D5E926B7541351689C4E34AB525C9B0581F30985C6785CD9DD980DE8582521C9B4A2914619F8341A576393B6272739646ED187678770AE0145DC5E1CD221778B9B9DFA454F1CE274EBADD89CF01832C854909566B27835F6BF4DBFF46903C710A7A66862FE5AB4027');
CREATE TABLE robot_state (
	robot TEXT NOT NULL,
	revision BIGINT NOT NULL,
	fence BIGINT NOT NULL,
	owner TEXT, folded BIGINT DEFAULT '0' NOT NULL,
	PRIMARY KEY (robot)
);
INSERT INTO "robot_state" VALUES('r1',2,1,'a6b9d36b9dc3527c',2);
INSERT INTO "robot_state" VALUES('r2',0,0,NULL,0);
INSERT INTO "robot_state" VALUES('gone',1,0,NULL,1);
INSERT INTO "robot_state" VALUES('r8',6,0,NULL,6);
INSERT INTO "robot_state" VALUES('r9',3,0,NULL,3);
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
INSERT INTO "robots" VALUES('r8','{"model":"tedusar"}','be3c798a21af630b8fdb','tedusar',1796000000000000000,1796000000000000000);
INSERT INTO "robots" VALUES('r9','{"model":"tedusar"}','be3c798a21af630b8fdb','tedusar',1796000000000000000,1796000000000000000);
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
CREATE TABLE start_ups (
	robot TEXT NOT NULL,
	topic TEXT NOT NULL,
	took TEXT NOT NULL,
	PRIMARY KEY (robot, topic)
) WITHOUT ROWID;
INSERT INTO "start_ups" VALUES('r8','scan','[2000000000]');
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
CREATE INDEX ix_audit_robot ON audit (robot, id);
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
CREATE INDEX ix_events_robot ON events (robot, kind, id);
DELETE FROM "sqlite_sequence";
INSERT INTO "sqlite_sequence" VALUES('repairs',2);
INSERT INTO "sqlite_sequence" VALUES('repair_requests',2);
INSERT INTO "sqlite_sequence" VALUES('journal',2);
INSERT INTO "sqlite_sequence" VALUES('tried',1);
INSERT INTO "sqlite_sequence" VALUES('attempts',1);
INSERT INTO "sqlite_sequence" VALUES('agent_actions',2);
INSERT INTO "sqlite_sequence" VALUES('api_keys',2);
INSERT INTO "sqlite_sequence" VALUES('drills',1);
INSERT INTO "sqlite_sequence" VALUES('notifications',1);
INSERT INTO "sqlite_sequence" VALUES('results',6);
INSERT INTO "sqlite_sequence" VALUES('batch_jobs',1);
COMMIT;
