PRAGMA foreign_keys=OFF;
BEGIN TRANSACTION;
CREATE TABLE alembic_version (
	version_num VARCHAR(32) NOT NULL, 
	PRIMARY KEY (version_num)
);
INSERT INTO alembic_version VALUES('0007');
CREATE TABLE counters (
	name TEXT NOT NULL, 
	value BIGINT NOT NULL, 
	PRIMARY KEY (name)
);
INSERT INTO counters VALUES('event',44);
INSERT INTO counters VALUES('audit',30);
CREATE TABLE models (
	name TEXT NOT NULL, 
	current INTEGER NOT NULL, 
	PRIMARY KEY (name)
);
INSERT INTO models VALUES('lidar_robot',1);
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
INSERT INTO model_versions VALUES('lidar_robot',1,'58319f71db7b38c971a4','component',replace('\nrobomend: 1\nname: lidar_robot\nhardware:\n  lidar: {channel: 1}\nnodes:\n  lidar_node: {drives: [lidar], publishes: {scan: []}}\n','\n',char(10)),1795417365098683426,'local');
CREATE TABLE robots (
	id TEXT NOT NULL, 
	config TEXT NOT NULL, 
	etag TEXT NOT NULL, 
	model TEXT, 
	created_ns BIGINT NOT NULL, 
	updated_ns BIGINT NOT NULL, 
	PRIMARY KEY (id)
);
INSERT INTO robots VALUES('r1','{"model":"lidar_robot","policy":"approve","limits":{"attempts_per_hour":12,"rounds":5},"allow":null,"protected":[],"board":null,"expected":{"stopped":[]},"observed":["ok(scan)"],"observed_timeout_s":30.0,"detection_s":2.5,"hold_s":86400.0,"debounce_s":0.0,"period_s":null,"unknown":"refuse","diagnosis":{"engine":"sat","minimal":"subset","max_size":null,"limit":100,"timeout_s":null},"planner":"pyperplan","domain":null,"actions":{},"windows":[]}','59b4bfe5394df9d3b540','lidar_robot',1795417365230254976,1795417365230254976);
INSERT INTO robots VALUES('r2','{"model":"lidar_robot","policy":"approve","limits":{"attempts_per_hour":12,"rounds":5},"allow":null,"protected":[],"board":null,"expected":{"stopped":[]},"observed":["ok(scan)"],"observed_timeout_s":30.0,"detection_s":2.5,"hold_s":86400.0,"debounce_s":0.0,"period_s":null,"unknown":"refuse","diagnosis":{"engine":"sat","minimal":"subset","max_size":null,"limit":100,"timeout_s":null},"planner":"pyperplan","domain":null,"actions":{},"windows":[]}','59b4bfe5394df9d3b540','lidar_robot',1795417365647556806,1795417365647556806);
INSERT INTO robots VALUES('r3','{"model":"lidar_robot","policy":"approve","limits":{"attempts_per_hour":12,"rounds":5},"allow":null,"protected":[],"board":null,"expected":{"stopped":[]},"observed":["ok(scan)"],"observed_timeout_s":30.0,"detection_s":2.5,"hold_s":86400.0,"debounce_s":0.0,"period_s":null,"unknown":"refuse","diagnosis":{"engine":"sat","minimal":"subset","max_size":null,"limit":100,"timeout_s":null},"planner":"pyperplan","domain":null,"actions":{},"windows":[]}','59b4bfe5394df9d3b540','lidar_robot',1795417365749726081,1795417365749726081);
CREATE TABLE robot_state (
	robot TEXT NOT NULL, 
	revision BIGINT NOT NULL, 
	fence BIGINT NOT NULL, 
	owner TEXT, 
	PRIMARY KEY (robot)
);
INSERT INTO robot_state VALUES('r1',1,1,'c3468b5264b91581');
INSERT INTO robot_state VALUES('r2',1,1,'c3468b5264b91581');
INSERT INTO robot_state VALUES('r3',1,1,'c3468b5264b91581');
CREATE TABLE observations (
	number INTEGER NOT NULL PRIMARY KEY AUTOINCREMENT, 
	robot TEXT NOT NULL, 
	revision BIGINT NOT NULL, 
	time_ns BIGINT NOT NULL, 
	data TEXT NOT NULL, 
	CONSTRAINT uq_observations_robot_revision UNIQUE (robot, revision)
);
INSERT INTO observations VALUES(1,'r1',1,1795417365576050219,'{"b":"local","e":[["ok",["scan"],true,"lidar_observer",1795417365572400616,null,1795417363072400616]]}');
INSERT INTO observations VALUES(2,'r2',1,1795417365678839208,'{"b":"local","e":[["ok",["scan"],true,"lidar_observer",1795417365673873120,null,1795417363173873120]]}');
INSERT INTO observations VALUES(3,'r3',1,1795417365798914878,'{"b":"local","e":[["ok",["scan"],true,"lidar_observer",1795417365795869919,null,1795417363295869919]]}');
CREATE TABLE obs (
	robot TEXT NOT NULL, 
	atom TEXT NOT NULL, 
	positive BOOLEAN NOT NULL, 
	source TEXT NOT NULL, 
	time_ns BIGINT NOT NULL, 
	expires_ns BIGINT, 
	since_ns BIGINT, 
	onset_ns BIGINT, 
	settled BIGINT, 
	PRIMARY KEY (robot, atom)
)
 WITHOUT ROWID

;
INSERT INTO obs VALUES('r1','["ok","scan"]',1,'lidar_observer',1795417365572400616,NULL,1795417363072400616,NULL,NULL);
INSERT INTO obs VALUES('r2','["ok","scan"]',1,'lidar_observer',1795417365673873120,NULL,1795417363173873120,NULL,NULL);
INSERT INTO obs VALUES('r3','["ok","scan"]',1,'lidar_observer',1795417365795869919,NULL,1795417363295869919,NULL,NULL);
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
CREATE TABLE diagnoses (
	number INTEGER NOT NULL PRIMARY KEY AUTOINCREMENT, 
	robot TEXT NOT NULL, 
	revision BIGINT NOT NULL, 
	model_version TEXT NOT NULL, 
	time_ns BIGINT NOT NULL, 
	result TEXT NOT NULL, 
	common BIGINT
);
INSERT INTO diagnoses VALUES(1,'r1',0,'58319f71db7b38c971a4',1795417365547954639,replace('{"revision":0,\n,"elapsed_s":0.000158}}','\n',char(10)),1);
INSERT INTO diagnoses VALUES(2,'r2',0,'58319f71db7b38c971a4',1795417365665654740,replace('{"revision":0,\n,"elapsed_s":0.000158}}','\n',char(10)),1);
INSERT INTO diagnoses VALUES(3,'r3',0,'58319f71db7b38c971a4',1795417365798914878,replace('{"revision":0,\n,"elapsed_s":0.000158}}','\n',char(10)),1);
CREATE TABLE results (
	number INTEGER NOT NULL PRIMARY KEY AUTOINCREMENT, 
	digest BLOB NOT NULL, 
	used_day INTEGER NOT NULL, 
	data BLOB NOT NULL, 
	UNIQUE (digest)
);
INSERT INTO results VALUES(1,X'60edbf2d883678d17f8904b05918fec3',20780,X'789c5d50cb8e83300cfc95c8672ea8bba2e557562b94040391521bc54e2942fdf70df471d8533c1e67666cb8728fb1bb6192c0042d7c9f4ff56568eade35ee74f697a6b65f50c16073546829c75801de67f48a7d27caf38c3db43fbf1524946366833ed89158500ab181b3af819179af2086dea6a279bc1d950050d839b1b32ec4a0ebdb67cf5634b6c721cef176289659c57b3102629d028d26885912d3d89a65b26a162b4610e9e8ef0d6b26b451a7d5c82a8a5723132f028fa2e4f93a4754845653c60a5e1b75ee13c2330d31787d597f60f7ff6b449b683fc69ed7efe80d3265795f2953b95ee4837b1a0cd6eb133ff53395ddea3f18f38de1');
CREATE TABLE events (
	id INTEGER NOT NULL, 
	time_ns BIGINT NOT NULL, 
	kind TEXT NOT NULL, 
	robot TEXT, 
	data TEXT NOT NULL, 
	common BIGINT, 
	PRIMARY KEY (id)
);
INSERT INTO events VALUES(1,1795417365098683426,'model',NULL,'{"name":"lidar_robot","version":"58319f71db7b38c971a4","number":1}',NULL);
INSERT INTO events VALUES(2,1795417365230254976,'robot','r1','{"what":"created","etag":"59b4bfe5394df9d3b540","by":"local"}',NULL);
INSERT INTO events VALUES(3,1795417365547954639,'diagnosis','r1',replace('{"revision":0,\n,"elapsed_s":0.000158}}','\n',char(10)),1);
INSERT INTO events VALUES(4,1795417365576050219,'observations','r1','{"revision":1,"changed":["ok(scan)"],"forgotten":[],"accepted_ns":1795417365572495833}',NULL);
INSERT INTO events VALUES(5,1795417365647556806,'robot','r2','{"what":"created","etag":"59b4bfe5394df9d3b540","by":"local"}',NULL);
INSERT INTO events VALUES(6,1795417365665654740,'diagnosis','r2',replace('{"revision":0,\n,"elapsed_s":0.000158}}','\n',char(10)),1);
INSERT INTO events VALUES(7,1795417365678839208,'observations','r2','{"revision":1,"changed":["ok(scan)"],"forgotten":[],"accepted_ns":1795417365673978249}',NULL);
INSERT INTO events VALUES(8,1795417365749726081,'robot','r3','{"what":"created","etag":"59b4bfe5394df9d3b540","by":"local"}',NULL);
INSERT INTO events VALUES(9,1795417365798914878,'diagnosis','r3',replace('{"revision":0,\n,"elapsed_s":0.000158}}','\n',char(10)),1);
INSERT INTO events VALUES(10,1795417365798914878,'observations','r3','{"revision":1,"changed":["ok(scan)"],"forgotten":[],"accepted_ns":1795417365795971345}',NULL);
INSERT INTO events VALUES(11,1795417365851094907,'drill','r1','{"id":"d-6zygevh9bq","robot":"r1","state":"waiting","fault":"device-unplugged","component":"lidar","topic":null,"planted_by":"a person","act":"pull the data cable of lidar","undo":"plug it in","undone":false,"bound_s":3000.0,"detect_s":60.0,"waiting_for":null,"cut_short":null,"seen":null,"reason":"","by":"local","planted_ns":null,"created_ns":1795417365851094907,"updated_ns":1795417365851094907,"finished_ns":null}',NULL);
INSERT INTO events VALUES(12,1795417365937506414,'drill','r1','{"id":"d-6zygevh9bq","robot":"r1","state":"planting","fault":"device-unplugged","component":"lidar","topic":null,"planted_by":"a person","act":"pull the data cable of lidar","undo":"plug it in","undone":false,"bound_s":3000.0,"detect_s":60.0,"waiting_for":null,"cut_short":null,"seen":null,"reason":"","by":"local","planted_ns":null,"created_ns":1795417365851094907,"updated_ns":1795417365937506414,"finished_ns":null}',NULL);
INSERT INTO events VALUES(13,1795417365991535321,'drill','r1','{"id":"d-6zygevh9bq","robot":"r1","state":"planting","fault":"device-unplugged","component":"lidar","topic":null,"planted_by":"a person","act":"pull the data cable of lidar","undo":"plug it in","undone":false,"bound_s":3000.0,"detect_s":60.0,"waiting_for":"pull the data cable of lidar","cut_short":null,"seen":null,"reason":"","by":"local","planted_ns":null,"created_ns":1795417365851094907,"updated_ns":1795417365991535321,"finished_ns":null}',NULL);
INSERT INTO events VALUES(14,1795417366050991934,'drill','r1','{"id":"d-6zygevh9bq","robot":"r1","state":"planting","fault":"device-unplugged","component":"lidar","topic":null,"planted_by":"a person","act":"pull the data cable of lidar","undo":"plug it in","undone":false,"bound_s":3000.0,"detect_s":60.0,"waiting_for":"pull the data cable of lidar","cut_short":null,"seen":null,"reason":"","by":"local","planted_ns":null,"created_ns":1795417365851094907,"updated_ns":1795417365991535321,"finished_ns":null,"asked":"cancel","asked_by":"local"}',NULL);
INSERT INTO events VALUES(15,1795417366065959607,'drill','r1','{"id":"d-6zygevh9bq","robot":"r1","state":"undoing","fault":"device-unplugged","component":"lidar","topic":null,"planted_by":"a person","act":"pull the data cable of lidar","undo":"plug it in","undone":false,"bound_s":3000.0,"detect_s":60.0,"waiting_for":null,"cut_short":"cancel: enough","seen":null,"reason":"cancel: enough","by":"local","planted_ns":null,"created_ns":1795417365851094907,"updated_ns":1795417366065959607,"finished_ns":null}',NULL);
INSERT INTO events VALUES(16,1795417366070167187,'drill','r1','{"id":"d-6zygevh9bq","robot":"r1","state":"undoing","fault":"device-unplugged","component":"lidar","topic":null,"planted_by":"a person","act":"pull the data cable of lidar","undo":"plug it in","undone":false,"bound_s":3000.0,"detect_s":60.0,"waiting_for":null,"cut_short":"cancel: enough","seen":null,"reason":"cancel: enough","by":"local","planted_ns":null,"created_ns":1795417365851094907,"updated_ns":1795417366070167187,"finished_ns":null}',NULL);
INSERT INTO events VALUES(17,1795417366082978175,'drill','r1','{"id":"d-6zygevh9bq","robot":"r1","state":"undoing","fault":"device-unplugged","component":"lidar","topic":null,"planted_by":"a person","act":"pull the data cable of lidar","undo":"plug it in","undone":false,"bound_s":3000.0,"detect_s":60.0,"waiting_for":"plug it in","cut_short":"cancel: enough","seen":null,"reason":"cancel: enough","by":"local","planted_ns":null,"created_ns":1795417365851094907,"updated_ns":1795417366082978175,"finished_ns":null}',NULL);
INSERT INTO events VALUES(18,1795417366130352393,'drill','r1','{"id":"d-6zygevh9bq","robot":"r1","state":"undoing","fault":"device-unplugged","component":"lidar","topic":null,"planted_by":"a person","act":"pull the data cable of lidar","undo":"plug it in","undone":false,"bound_s":3000.0,"detect_s":60.0,"waiting_for":"plug it in","cut_short":"cancel: enough","seen":null,"reason":"cancel: enough","by":"local","planted_ns":null,"created_ns":1795417365851094907,"updated_ns":1795417366082978175,"finished_ns":null,"asked":"done","asked_by":"local"}',NULL);
INSERT INTO events VALUES(19,1795417366178949075,'drill','r1','{"id":"d-6zygevh9bq","robot":"r1","state":"recovering","fault":"device-unplugged","component":"lidar","topic":null,"planted_by":"a person","act":"pull the data cable of lidar","undo":"plug it in","undone":true,"bound_s":3000.0,"detect_s":60.0,"waiting_for":null,"cut_short":"cancel: enough","seen":null,"reason":"","by":"local","planted_ns":null,"created_ns":1795417365851094907,"updated_ns":1795417366178949075,"finished_ns":null}',NULL);
INSERT INTO events VALUES(20,1795417368838469418,'drill','r1','{"id":"d-6zygevh9bq","robot":"r1","state":"cancelled","fault":"device-unplugged","component":"lidar","topic":null,"planted_by":"a person","act":"pull the data cable of lidar","undo":"plug it in","undone":true,"bound_s":3000.0,"detect_s":60.0,"waiting_for":null,"cut_short":"cancel: enough","seen":null,"reason":"cancel: enough","by":"local","planted_ns":null,"created_ns":1795417365851094907,"updated_ns":1795417368838469418,"finished_ns":1795417368838469418}',NULL);
INSERT INTO events VALUES(21,1795417368885821271,'drill','r1','{"id":"d-m2mh9x6mcr","robot":"r1","state":"waiting","fault":"device-unplugged","component":"lidar","topic":null,"planted_by":"a person","act":"pull the data cable of lidar","undo":"plug it in","undone":false,"bound_s":3000.0,"detect_s":60.0,"waiting_for":null,"cut_short":null,"seen":null,"reason":"","by":"local","planted_ns":null,"created_ns":1795417368885821271,"updated_ns":1795417368885821271,"finished_ns":null}',NULL);
INSERT INTO events VALUES(22,1795417368925670094,'drill','r1','{"id":"d-m2mh9x6mcr","robot":"r1","state":"planting","fault":"device-unplugged","component":"lidar","topic":null,"planted_by":"a person","act":"pull the data cable of lidar","undo":"plug it in","undone":false,"bound_s":3000.0,"detect_s":60.0,"waiting_for":null,"cut_short":null,"seen":null,"reason":"","by":"local","planted_ns":null,"created_ns":1795417368885821271,"updated_ns":1795417368925670094,"finished_ns":null}',NULL);
INSERT INTO events VALUES(23,1795417368964504971,'drill','r1','{"id":"d-m2mh9x6mcr","robot":"r1","state":"planting","fault":"device-unplugged","component":"lidar","topic":null,"planted_by":"a person","act":"pull the data cable of lidar","undo":"plug it in","undone":false,"bound_s":3000.0,"detect_s":60.0,"waiting_for":"pull the data cable of lidar","cut_short":null,"seen":null,"reason":"","by":"local","planted_ns":null,"created_ns":1795417368885821271,"updated_ns":1795417368964504971,"finished_ns":null}',NULL);
INSERT INTO events VALUES(24,1795417369011806831,'drill','r1','{"id":"d-m2mh9x6mcr","robot":"r1","state":"planting","fault":"device-unplugged","component":"lidar","topic":null,"planted_by":"a person","act":"pull the data cable of lidar","undo":"plug it in","undone":false,"bound_s":3000.0,"detect_s":60.0,"waiting_for":"pull the data cable of lidar","cut_short":null,"seen":null,"reason":"","by":"local","planted_ns":null,"created_ns":1795417368885821271,"updated_ns":1795417368964504971,"finished_ns":null,"asked":"cancel","asked_by":"local"}',NULL);
INSERT INTO events VALUES(25,1795417369030398822,'drill','r1','{"id":"d-m2mh9x6mcr","robot":"r1","state":"undoing","fault":"device-unplugged","component":"lidar","topic":null,"planted_by":"a person","act":"pull the data cable of lidar","undo":"plug it in","undone":false,"bound_s":3000.0,"detect_s":60.0,"waiting_for":null,"cut_short":"cancel: no","seen":null,"reason":"cancel: no","by":"local","planted_ns":null,"created_ns":1795417368885821271,"updated_ns":1795417369030398822,"finished_ns":null}',NULL);
INSERT INTO events VALUES(26,1795417369035627117,'drill','r1','{"id":"d-m2mh9x6mcr","robot":"r1","state":"undoing","fault":"device-unplugged","component":"lidar","topic":null,"planted_by":"a person","act":"pull the data cable of lidar","undo":"plug it in","undone":false,"bound_s":3000.0,"detect_s":60.0,"waiting_for":null,"cut_short":"cancel: no","seen":null,"reason":"cancel: no","by":"local","planted_ns":null,"created_ns":1795417368885821271,"updated_ns":1795417369035627117,"finished_ns":null}',NULL);
INSERT INTO events VALUES(27,1795417369038872303,'drill','r1','{"id":"d-m2mh9x6mcr","robot":"r1","state":"undoing","fault":"device-unplugged","component":"lidar","topic":null,"planted_by":"a person","act":"pull the data cable of lidar","undo":"plug it in","undone":false,"bound_s":3000.0,"detect_s":60.0,"waiting_for":"plug it in","cut_short":"cancel: no","seen":null,"reason":"cancel: no","by":"local","planted_ns":null,"created_ns":1795417368885821271,"updated_ns":1795417369038872303,"finished_ns":null}',NULL);
INSERT INTO events VALUES(28,1795417369088050226,'drill','r1','{"id":"d-m2mh9x6mcr","robot":"r1","state":"undoing","fault":"device-unplugged","component":"lidar","topic":null,"planted_by":"a person","act":"pull the data cable of lidar","undo":"plug it in","undone":false,"bound_s":3000.0,"detect_s":60.0,"waiting_for":"plug it in","cut_short":"cancel: no","seen":null,"reason":"cancel: no","by":"local","planted_ns":null,"created_ns":1795417368885821271,"updated_ns":1795417369038872303,"finished_ns":null,"asked":"abandon","asked_by":"local"}',NULL);
INSERT INTO events VALUES(29,1795417369114837796,'drill','r1','{"id":"d-m2mh9x6mcr","robot":"r1","state":"failed","fault":"device-unplugged","component":"lidar","topic":null,"planted_by":"a person","act":"pull the data cable of lidar","undo":"plug it in","undone":false,"bound_s":3000.0,"detect_s":60.0,"waiting_for":null,"cut_short":"cancel: no","seen":null,"reason":"abandon: lost the plug; not undone by robomend: plug it in","by":"local","planted_ns":null,"created_ns":1795417368885821271,"updated_ns":1795417369114837796,"finished_ns":1795417369114837796}',NULL);
INSERT INTO events VALUES(30,1795417369184666737,'drill','r1','{"id":"d-sm48tg9pd2","robot":"r1","state":"waiting","fault":"device-unplugged","component":"lidar","topic":null,"planted_by":"a person","act":"pull the data cable of lidar","undo":"plug it in","undone":false,"bound_s":3000.0,"detect_s":60.0,"waiting_for":null,"cut_short":null,"seen":null,"reason":"","by":"local","planted_ns":null,"created_ns":1795417369184666737,"updated_ns":1795417369184666737,"finished_ns":null}',NULL);
INSERT INTO events VALUES(31,1795417369227928670,'drill','r1','{"id":"d-sm48tg9pd2","robot":"r1","state":"planting","fault":"device-unplugged","component":"lidar","topic":null,"planted_by":"a person","act":"pull the data cable of lidar","undo":"plug it in","undone":false,"bound_s":3000.0,"detect_s":60.0,"waiting_for":null,"cut_short":null,"seen":null,"reason":"","by":"local","planted_ns":null,"created_ns":1795417369184666737,"updated_ns":1795417369227928670,"finished_ns":null}',NULL);
INSERT INTO events VALUES(32,1795417369232269687,'drill','r1','{"id":"d-sm48tg9pd2","robot":"r1","state":"planting","fault":"device-unplugged","component":"lidar","topic":null,"planted_by":"a person","act":"pull the data cable of lidar","undo":"plug it in","undone":false,"bound_s":3000.0,"detect_s":60.0,"waiting_for":"pull the data cable of lidar","cut_short":null,"seen":null,"reason":"","by":"local","planted_ns":null,"created_ns":1795417369184666737,"updated_ns":1795417369232269687,"finished_ns":null}',NULL);
INSERT INTO events VALUES(33,1795417369321149495,'drill','r2','{"id":"d-j52wj67yw2","robot":"r2","state":"waiting","fault":"device-unplugged","component":"lidar","topic":null,"planted_by":"a person","act":"pull the data cable of lidar","undo":"plug it in","undone":false,"bound_s":3000.0,"detect_s":60.0,"waiting_for":null,"cut_short":null,"seen":null,"reason":"","by":"local","planted_ns":null,"created_ns":1795417369321149495,"updated_ns":1795417369321149495,"finished_ns":null}',NULL);
INSERT INTO events VALUES(34,1795417369337583725,'drill','r2','{"id":"d-j52wj67yw2","robot":"r2","state":"planting","fault":"device-unplugged","component":"lidar","topic":null,"planted_by":"a person","act":"pull the data cable of lidar","undo":"plug it in","undone":false,"bound_s":3000.0,"detect_s":60.0,"waiting_for":null,"cut_short":null,"seen":null,"reason":"","by":"local","planted_ns":null,"created_ns":1795417369321149495,"updated_ns":1795417369337583725,"finished_ns":null}',NULL);
INSERT INTO events VALUES(35,1795417369341361861,'drill','r2','{"id":"d-j52wj67yw2","robot":"r2","state":"planting","fault":"device-unplugged","component":"lidar","topic":null,"planted_by":"a person","act":"pull the data cable of lidar","undo":"plug it in","undone":false,"bound_s":3000.0,"detect_s":60.0,"waiting_for":"pull the data cable of lidar","cut_short":null,"seen":null,"reason":"","by":"local","planted_ns":null,"created_ns":1795417369321149495,"updated_ns":1795417369341361861,"finished_ns":null}',NULL);
INSERT INTO events VALUES(36,1795417369415829343,'drill','r2','{"id":"d-j52wj67yw2","robot":"r2","state":"planting","fault":"device-unplugged","component":"lidar","topic":null,"planted_by":"a person","act":"pull the data cable of lidar","undo":"plug it in","undone":false,"bound_s":3000.0,"detect_s":60.0,"waiting_for":"pull the data cable of lidar","cut_short":null,"seen":null,"reason":"","by":"local","planted_ns":null,"created_ns":1795417369321149495,"updated_ns":1795417369341361861,"finished_ns":null,"asked":"done","asked_by":"local"}',NULL);
INSERT INTO events VALUES(37,1795417369425565949,'drill','r2','{"id":"d-j52wj67yw2","robot":"r2","state":"planted","fault":"device-unplugged","component":"lidar","topic":null,"planted_by":"a person","act":"pull the data cable of lidar","undo":"plug it in","undone":false,"bound_s":3000.0,"detect_s":60.0,"waiting_for":null,"cut_short":null,"seen":null,"reason":"","by":"local","planted_ns":1795417369425431427,"created_ns":1795417369321149495,"updated_ns":1795417369425565949,"finished_ns":null}',NULL);
INSERT INTO events VALUES(38,1795417369497422265,'drill','r3','{"id":"d-tdj7zfch4h","robot":"r3","state":"waiting","fault":"device-unplugged","component":"lidar","topic":null,"planted_by":"a person","act":"pull the data cable of lidar","undo":"plug it in","undone":false,"bound_s":3000.0,"detect_s":60.0,"waiting_for":null,"cut_short":null,"seen":null,"reason":"","by":"local","planted_ns":null,"created_ns":1795417369497422265,"updated_ns":1795417369497422265,"finished_ns":null}',NULL);
INSERT INTO events VALUES(39,1795417369505822185,'drill','r3','{"id":"d-tdj7zfch4h","robot":"r3","state":"planting","fault":"device-unplugged","component":"lidar","topic":null,"planted_by":"a person","act":"pull the data cable of lidar","undo":"plug it in","undone":false,"bound_s":3000.0,"detect_s":60.0,"waiting_for":null,"cut_short":null,"seen":null,"reason":"","by":"local","planted_ns":null,"created_ns":1795417369497422265,"updated_ns":1795417369505822185,"finished_ns":null}',NULL);
INSERT INTO events VALUES(40,1795417369512543291,'drill','r3','{"id":"d-tdj7zfch4h","robot":"r3","state":"planting","fault":"device-unplugged","component":"lidar","topic":null,"planted_by":"a person","act":"pull the data cable of lidar","undo":"plug it in","undone":false,"bound_s":3000.0,"detect_s":60.0,"waiting_for":"pull the data cable of lidar","cut_short":null,"seen":null,"reason":"","by":"local","planted_ns":null,"created_ns":1795417369497422265,"updated_ns":1795417369512543291,"finished_ns":null}',NULL);
INSERT INTO events VALUES(41,1795417369568178714,'drill','r3','{"id":"d-tdj7zfch4h","robot":"r3","state":"planting","fault":"device-unplugged","component":"lidar","topic":null,"planted_by":"a person","act":"pull the data cable of lidar","undo":"plug it in","undone":false,"bound_s":3000.0,"detect_s":60.0,"waiting_for":"pull the data cable of lidar","cut_short":null,"seen":null,"reason":"","by":"local","planted_ns":null,"created_ns":1795417369497422265,"updated_ns":1795417369512543291,"finished_ns":null,"asked":"cancel","asked_by":"local"}',NULL);
INSERT INTO events VALUES(42,1795417369573080982,'drill','r3','{"id":"d-tdj7zfch4h","robot":"r3","state":"undoing","fault":"device-unplugged","component":"lidar","topic":null,"planted_by":"a person","act":"pull the data cable of lidar","undo":"plug it in","undone":false,"bound_s":3000.0,"detect_s":60.0,"waiting_for":null,"cut_short":"cancel: no","seen":null,"reason":"cancel: no","by":"local","planted_ns":null,"created_ns":1795417369497422265,"updated_ns":1795417369573080982,"finished_ns":null}',NULL);
INSERT INTO events VALUES(43,1795417369576659567,'drill','r3','{"id":"d-tdj7zfch4h","robot":"r3","state":"undoing","fault":"device-unplugged","component":"lidar","topic":null,"planted_by":"a person","act":"pull the data cable of lidar","undo":"plug it in","undone":false,"bound_s":3000.0,"detect_s":60.0,"waiting_for":null,"cut_short":"cancel: no","seen":null,"reason":"cancel: no","by":"local","planted_ns":null,"created_ns":1795417369497422265,"updated_ns":1795417369576659567,"finished_ns":null}',NULL);
INSERT INTO events VALUES(44,1795417369583124829,'drill','r3','{"id":"d-tdj7zfch4h","robot":"r3","state":"undoing","fault":"device-unplugged","component":"lidar","topic":null,"planted_by":"a person","act":"pull the data cable of lidar","undo":"plug it in","undone":false,"bound_s":3000.0,"detect_s":60.0,"waiting_for":"plug it in","cut_short":"cancel: no","seen":null,"reason":"cancel: no","by":"local","planted_ns":null,"created_ns":1795417369497422265,"updated_ns":1795417369583124829,"finished_ns":null}',NULL);
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
INSERT INTO audit VALUES(1,1795417365098683426,'local','model.put','lidar_robot',NULL,'',NULL,'{"version":"58319f71db7b38c971a4"}');
INSERT INTO audit VALUES(2,1795417365230254976,'local','robot.put','r1','r1','',NULL,'{"model":"lidar_robot","policy":"approve","limits":{"attempts_per_hour":12,"rounds":5},"allow":null,"protected":[],"board":null,"expected":{"stopped":[]},"observed":["ok(scan)"],"observed_timeout_s":30.0,"detection_s":2.5,"hold_s":86400.0,"debounce_s":0.0,"period_s":null,"unknown":"refuse","diagnosis":{"engine":"sat","minimal":"subset","max_size":null,"limit":100,"timeout_s":null},"planner":"pyperplan","domain":null,"actions":{},"windows":[]}');
INSERT INTO audit VALUES(3,1795417365576050219,'local','observations.report','lidar_observer','r1','',NULL,'{"revision":1,"observations":["ok(scan)"],"in_place_of_the_robot":false}');
INSERT INTO audit VALUES(4,1795417365647556806,'local','robot.put','r2','r2','',NULL,'{"model":"lidar_robot","policy":"approve","limits":{"attempts_per_hour":12,"rounds":5},"allow":null,"protected":[],"board":null,"expected":{"stopped":[]},"observed":["ok(scan)"],"observed_timeout_s":30.0,"detection_s":2.5,"hold_s":86400.0,"debounce_s":0.0,"period_s":null,"unknown":"refuse","diagnosis":{"engine":"sat","minimal":"subset","max_size":null,"limit":100,"timeout_s":null},"planner":"pyperplan","domain":null,"actions":{},"windows":[]}');
INSERT INTO audit VALUES(5,1795417365678839208,'local','observations.report','lidar_observer','r2','',NULL,'{"revision":1,"observations":["ok(scan)"],"in_place_of_the_robot":false}');
INSERT INTO audit VALUES(6,1795417365749726081,'local','robot.put','r3','r3','',NULL,'{"model":"lidar_robot","policy":"approve","limits":{"attempts_per_hour":12,"rounds":5},"allow":null,"protected":[],"board":null,"expected":{"stopped":[]},"observed":["ok(scan)"],"observed_timeout_s":30.0,"detection_s":2.5,"hold_s":86400.0,"debounce_s":0.0,"period_s":null,"unknown":"refuse","diagnosis":{"engine":"sat","minimal":"subset","max_size":null,"limit":100,"timeout_s":null},"planner":"pyperplan","domain":null,"actions":{},"windows":[]}');
INSERT INTO audit VALUES(7,1795417365798914878,'local','observations.report','lidar_observer','r3','',NULL,'{"revision":1,"observations":["ok(scan)"],"in_place_of_the_robot":false}');
INSERT INTO audit VALUES(8,1795417365851094907,'local','drill.create','d-6zygevh9bq','r1','',NULL,'{"fault":"device-unplugged:lidar"}');
INSERT INTO audit VALUES(9,1795417365937506414,'robomend','drill.planting','d-6zygevh9bq','r1','the robot is as it must be; the undo is written down','{"state":"waiting"}','{"state":"planting","fault":"device-unplugged:lidar","undo":"plug it in"}');
INSERT INTO audit VALUES(10,1795417366050991934,'local','drill.cancel','d-6zygevh9bq','r1','enough',NULL,NULL);
INSERT INTO audit VALUES(11,1795417366065959607,'local','drill.undoing','d-6zygevh9bq','r1','cancel: enough','{"state":"planting"}','{"state":"undoing","fault":"device-unplugged:lidar","undo":"plug it in"}');
INSERT INTO audit VALUES(12,1795417366130352393,'local','drill.done','d-6zygevh9bq','r1','it is in again',NULL,NULL);
INSERT INTO audit VALUES(13,1795417366178949075,'robomend','drill.recovering','d-6zygevh9bq','r1','what was planted is undone','{"state":"undoing"}','{"state":"recovering","fault":"device-unplugged:lidar","undo":"plug it in"}');
INSERT INTO audit VALUES(14,1795417368838469418,'robomend','drill.cancelled','d-6zygevh9bq','r1','cancel: enough','{"state":"recovering"}','{"state":"cancelled","fault":"device-unplugged:lidar","undo":"plug it in"}');
INSERT INTO audit VALUES(15,1795417368885821271,'local','drill.create','d-m2mh9x6mcr','r1','',NULL,'{"fault":"device-unplugged:lidar"}');
INSERT INTO audit VALUES(16,1795417368925670094,'robomend','drill.planting','d-m2mh9x6mcr','r1','the robot is as it must be; the undo is written down','{"state":"waiting"}','{"state":"planting","fault":"device-unplugged:lidar","undo":"plug it in"}');
INSERT INTO audit VALUES(17,1795417369011806831,'local','drill.cancel','d-m2mh9x6mcr','r1','no',NULL,NULL);
INSERT INTO audit VALUES(18,1795417369030398822,'local','drill.undoing','d-m2mh9x6mcr','r1','cancel: no','{"state":"planting"}','{"state":"undoing","fault":"device-unplugged:lidar","undo":"plug it in"}');
INSERT INTO audit VALUES(19,1795417369088050226,'local','drill.abandon','d-m2mh9x6mcr','r1','lost the plug',NULL,NULL);
INSERT INTO audit VALUES(20,1795417369114837796,'local','drill.failed','d-m2mh9x6mcr','r1','abandon: lost the plug; not undone by robomend: plug it in','{"state":"undoing"}','{"state":"failed","fault":"device-unplugged:lidar","undo":"plug it in"}');
INSERT INTO audit VALUES(21,1795417369184666737,'local','drill.create','d-sm48tg9pd2','r1','',NULL,'{"fault":"device-unplugged:lidar"}');
INSERT INTO audit VALUES(22,1795417369227928670,'robomend','drill.planting','d-sm48tg9pd2','r1','the robot is as it must be; the undo is written down','{"state":"waiting"}','{"state":"planting","fault":"device-unplugged:lidar","undo":"plug it in"}');
INSERT INTO audit VALUES(23,1795417369321149495,'local','drill.create','d-j52wj67yw2','r2','',NULL,'{"fault":"device-unplugged:lidar"}');
INSERT INTO audit VALUES(24,1795417369337583725,'robomend','drill.planting','d-j52wj67yw2','r2','the robot is as it must be; the undo is written down','{"state":"waiting"}','{"state":"planting","fault":"device-unplugged:lidar","undo":"plug it in"}');
INSERT INTO audit VALUES(25,1795417369415829343,'local','drill.done','d-j52wj67yw2','r2','it is out',NULL,NULL);
INSERT INTO audit VALUES(26,1795417369425565949,'robomend','drill.planted','d-j52wj67yw2','r2','the fault is there','{"state":"planting"}','{"state":"planted","fault":"device-unplugged:lidar","undo":"plug it in"}');
INSERT INTO audit VALUES(27,1795417369497422265,'local','drill.create','d-tdj7zfch4h','r3','',NULL,'{"fault":"device-unplugged:lidar"}');
INSERT INTO audit VALUES(28,1795417369505822185,'robomend','drill.planting','d-tdj7zfch4h','r3','the robot is as it must be; the undo is written down','{"state":"waiting"}','{"state":"planting","fault":"device-unplugged:lidar","undo":"plug it in"}');
INSERT INTO audit VALUES(29,1795417369568178714,'local','drill.cancel','d-tdj7zfch4h','r3','no',NULL,NULL);
INSERT INTO audit VALUES(30,1795417369573080982,'local','drill.undoing','d-tdj7zfch4h','r3','cancel: no','{"state":"planting"}','{"state":"undoing","fault":"device-unplugged:lidar","undo":"plug it in"}');
CREATE TABLE idempotency (
	scope TEXT NOT NULL, 
	"key" TEXT NOT NULL, 
	request TEXT NOT NULL, 
	response TEXT NOT NULL, 
	expires_ns BIGINT NOT NULL, 
	PRIMARY KEY (scope, "key")
);
INSERT INTO idempotency VALUES('local POST /robots/r1/observations','ddaaee56952641c6b843b2136b061ac8','eff613f49e7b555bc8e7e92e5d412fa6eb27b897b13911e462d34bb74cd25347','{"revision":1,"changed":["ok(scan)"]}',1795503765576050219);
INSERT INTO idempotency VALUES('local POST /robots/r2/observations','ccda81962cff4a3db10770cb6f0b535a','eff613f49e7b555bc8e7e92e5d412fa6eb27b897b13911e462d34bb74cd25347','{"revision":1,"changed":["ok(scan)"]}',1795503765678839208);
INSERT INTO idempotency VALUES('local POST /robots/r3/observations','63ffff9a15314ae9bc7813642a19b15e','eff613f49e7b555bc8e7e92e5d412fa6eb27b897b13911e462d34bb74cd25347','{"revision":1,"changed":["ok(scan)"]}',1795503765798914878);
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
CREATE TABLE repair_steps (
	repair TEXT NOT NULL, 
	step INTEGER NOT NULL, 
	state TEXT NOT NULL, 
	data TEXT NOT NULL, 
	updated_ns BIGINT NOT NULL, 
	PRIMARY KEY (repair, step)
);
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
INSERT INTO drills VALUES(1,'d-6zygevh9bq','r1','cancelled',0,0,'{"what":"done","by":"local","reason":"it is in again","time_ns":1795417366130352393}','{"fault":"device-unplugged","component":"lidar","topic":null,"planted_by":"a person","act":"pull the data cable of lidar","undo":"plug it in","bound_s":3000.0,"detect_s":60.0,"by":"local","asked_for":"","reason":"cancel: enough","waiting_for":null,"undone":true,"cut_short":"cancel: enough","tries":1}',1795417365851094907,1795417368838469418);
INSERT INTO drills VALUES(2,'d-m2mh9x6mcr','r1','failed',0,0,NULL,'{"fault":"device-unplugged","component":"lidar","topic":null,"planted_by":"a person","act":"pull the data cable of lidar","undo":"plug it in","bound_s":3000.0,"detect_s":60.0,"by":"local","asked_for":"","reason":"abandon: lost the plug; not undone by robomend: plug it in","waiting_for":null,"undone":false,"cut_short":"cancel: no","tries":1}',1795417368885821271,1795417369114837796);
INSERT INTO drills VALUES(3,'d-sm48tg9pd2','r1','planting',1,0,NULL,'{"fault":"device-unplugged","component":"lidar","topic":null,"planted_by":"a person","act":"pull the data cable of lidar","undo":"plug it in","bound_s":3000.0,"detect_s":60.0,"by":"local","asked_for":"","reason":"","waiting_for":"pull the data cable of lidar","undone":false}',1795417369184666737,1795417369232269687);
INSERT INTO drills VALUES(4,'d-j52wj67yw2','r2','planted',1,1,'{"what":"done","by":"local","reason":"it is out","time_ns":1795417369415829343}','{"fault":"device-unplugged","component":"lidar","topic":null,"planted_by":"a person","act":"pull the data cable of lidar","undo":"plug it in","bound_s":3000.0,"detect_s":60.0,"by":"local","asked_for":"","reason":"","waiting_for":null,"undone":false,"planted_ns":1795417369425431427}',1795417369321149495,1795417369425565949);
INSERT INTO drills VALUES(5,'d-tdj7zfch4h','r3','undoing',1,0,NULL,'{"fault":"device-unplugged","component":"lidar","topic":null,"planted_by":"a person","act":"pull the data cable of lidar","undo":"plug it in","bound_s":3000.0,"detect_s":60.0,"by":"local","asked_for":"","reason":"cancel: no","waiting_for":"plug it in","undone":false,"cut_short":"cancel: no","tries":1}',1795417369497422265,1795417369583124829);
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
CREATE TABLE quarantine (
	robot TEXT NOT NULL, 
	component TEXT NOT NULL, 
	reason TEXT NOT NULL, 
	failures INTEGER NOT NULL, 
	since_ns BIGINT NOT NULL, 
	until_ns BIGINT, 
	PRIMARY KEY (robot, component)
);
CREATE TABLE attempts (
	number INTEGER NOT NULL PRIMARY KEY AUTOINCREMENT, 
	robot TEXT NOT NULL, 
	component TEXT NOT NULL, 
	repair TEXT NOT NULL, 
	time_ns BIGINT NOT NULL
);
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
CREATE TABLE sign_ins (
	hash TEXT NOT NULL, 
	"key" TEXT NOT NULL, 
	created_ns BIGINT NOT NULL, 
	expires_ns BIGINT NOT NULL, 
	PRIMARY KEY (hash)
);
CREATE TABLE settings (
	name TEXT NOT NULL, 
	value TEXT NOT NULL, 
	PRIMARY KEY (name)
);
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
CREATE TABLE instances (
	id TEXT NOT NULL, 
	host TEXT NOT NULL, 
	pid INTEGER NOT NULL, 
	started_ns BIGINT NOT NULL, 
	heartbeat_ns BIGINT NOT NULL, 
	PRIMARY KEY (id)
);
INSERT INTO instances VALUES('c3468b5264b91581','vm',915,1795417363262265513,1795417363472712665);
DELETE FROM sqlite_sequence;
INSERT INTO sqlite_sequence VALUES('results',1);
INSERT INTO sqlite_sequence VALUES('diagnoses',3);
INSERT INTO sqlite_sequence VALUES('observations',3);
INSERT INTO sqlite_sequence VALUES('drills',5);
CREATE INDEX ix_robots_model ON robots (model);
CREATE INDEX ix_robot_state_owner ON robot_state (owner);
CREATE INDEX ix_diagnoses_robot ON diagnoses (robot, number);
CREATE INDEX ix_results_used_day ON results (used_day);
CREATE INDEX ix_events_robot ON events (robot, id);
CREATE INDEX ix_audit_robot ON audit (robot, id);
CREATE INDEX ix_idempotency_expires ON idempotency (expires_ns);
CREATE INDEX ix_repairs_open ON repairs (robot) WHERE open;
CREATE INDEX ix_repairs_robot ON repairs (robot, number);
CREATE INDEX ix_repair_requests_repair ON repair_requests (repair);
CREATE INDEX ix_repair_requests_open ON repair_requests (robot) WHERE NOT done;
CREATE INDEX ix_journal_unsettled ON journal (robot) WHERE settled_ns IS NULL;
CREATE INDEX ix_journal_repair ON journal (repair);
CREATE INDEX ix_drills_robot ON drills (robot, number);
CREATE INDEX ix_drills_open ON drills (robot) WHERE open;
CREATE INDEX ix_tried_robot ON tried (robot, number);
CREATE INDEX ix_attempts_robot ON attempts (robot, time_ns);
CREATE INDEX ix_sign_ins_key ON sign_ins ("key");
CREATE INDEX ix_notifications_due ON notifications (due_ns) WHERE due_ns IS NOT NULL;
CREATE INDEX ix_notifications_key ON notifications ("key", recipient);
CREATE INDEX ix_batch_jobs_open ON batch_jobs (place) WHERE open;
CREATE INDEX ix_agent_actions_waiting ON agent_actions (robot) WHERE settled_ns IS NULL;
COMMIT;
