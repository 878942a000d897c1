CREATE TABLE start_ups (
	robot text COLLATE "C" NOT NULL,
	topic text COLLATE "C" NOT NULL,
	took text COLLATE "C" NOT NULL,
	PRIMARY KEY (robot, topic)
);
UPDATE counters SET value = 21 WHERE name = 'event';
INSERT INTO diagnoses (number, robot, revision, model_version, time_ns, result, common) VALUES (4, 'r8', 1, 'v2', 1796000000000000000, '{"revision":1,
,"elapsed_s":0.0005}}', 2);
INSERT INTO diagnoses (number, robot, revision, model_version, time_ns, result, common) VALUES (5, 'r8', 2, 'v2', 1796000001000000000, '{"revision":2,
,"elapsed_s":0.0005}}', 3);
INSERT INTO diagnoses (number, robot, revision, model_version, time_ns, result, common) VALUES (6, 'r8', 3, 'v2', 1796086401000000000, '{"revision":3,
,"elapsed_s":0.0005}}', 2);
INSERT INTO diagnoses (number, robot, revision, model_version, time_ns, result, common) VALUES (7, 'r8', 4, 'v2', 1796086401000000000, '{"revision":4,
,"elapsed_s":0.0005}}', 4);
INSERT INTO diagnoses (number, robot, revision, model_version, time_ns, result, common) VALUES (8, 'r8', 5, 'v2', 1796086401000000000, '{"revision":5,
,"elapsed_s":0.0005}}', 2);
INSERT INTO diagnoses (number, robot, revision, model_version, time_ns, result, common) VALUES (9, 'r9', 2, 'v2', 1796086404000000000, '{"revision":2,
,"elapsed_s":0.0005}}', 6);
DELETE FROM events WHERE id = 1;
DELETE FROM events WHERE id = 2;
DELETE FROM events WHERE id = 5;
DELETE FROM events WHERE id = 3;
DELETE FROM events WHERE id = 4;
INSERT INTO events (id, time_ns, kind, robot, data, common) VALUES (10, 1796086401000000000, 'observations', 'r8', '{"revision":3,"changed":["ok(scan)"],"forgotten":[],"accepted_ns":1796086400999600000}', NULL);
INSERT INTO events (id, time_ns, kind, robot, data, common) VALUES (11, 1796086401000000000, 'diagnosis', 'r8', '{"revision":3,
,"elapsed_s":0.0005}}', 2);
INSERT INTO events (id, time_ns, kind, robot, data, common) VALUES (12, 1796086401000000000, 'observations', 'r8', '{"revision":4,"changed":["not ok(odom)"],"forgotten":[],"accepted_ns":1796086400999600000}', NULL);
INSERT INTO events (id, time_ns, kind, robot, data, common) VALUES (13, 1796086401000000000, 'diagnosis', 'r8', '{"revision":4,
,"elapsed_s":0.0005}}', 4);
INSERT INTO events (id, time_ns, kind, robot, data, common) VALUES (14, 1796086401000000000, 'observations', 'r9', '{"revision":1,"changed":["not ok(odom)"],"forgotten":[],"accepted_ns":1796086400999600000}', NULL);
INSERT INTO events (id, time_ns, kind, robot, data, common) VALUES (15, 1796086401000000000, 'observations', 'r8', '{"revision":5,"changed":["ok(odom)"],"forgotten":[],"accepted_ns":1796086400999600000}', NULL);
INSERT INTO events (id, time_ns, kind, robot, data, common) VALUES (16, 1796086401000000000, 'diagnosis', 'r8', '{"revision":5,
,"elapsed_s":0.0005}}', 2);
INSERT INTO events (id, time_ns, kind, robot, data, common) VALUES (17, 1796086402000000000, 'observations', 'r8', '{"revision":6,"changed":["inc(odom_yaw)","not dec(odom_yaw)","not const(odom_yaw)"],"forgotten":[],"accepted_ns":1796086401999600000}', NULL);
INSERT INTO events (id, time_ns, kind, robot, data, common) VALUES (18, 1796086403000000000, 'observations', 'r9', '{"revision":2,"changed":["ok(map)"],"forgotten":["ok(odom)"],"accepted_ns":1796086402999600000}', NULL);
INSERT INTO events (id, time_ns, kind, robot, data, common) VALUES (19, 1796086404000000000, 'diagnosis', 'r9', '{"revision":2,
,"elapsed_s":0.0005}}', 6);
INSERT INTO events (id, time_ns, kind, robot, data, common) VALUES (20, 1796086404000000000, 'observations', 'r9', '{"revision":3,"changed":[],"forgotten":[],"accepted_ns":1796086403999600000}', NULL);
INSERT INTO events (id, time_ns, kind, robot, data, common) VALUES (21, 1796086404000000000, 'robot', 'r9', '{"etag":"x","what":"updated"}', NULL);
INSERT INTO obs (robot, atom, positive, source, time_ns, expires_ns, since_ns, onset_ns, settled) VALUES ('r8', '["ok","scan"]', true, 'general', 1796086400999999995, NULL, NULL, NULL, NULL);
INSERT INTO obs (robot, atom, positive, source, time_ns, expires_ns, since_ns, onset_ns, settled) VALUES ('r8', '["ok","odom"]', true, 'general', 1796086400999999995, NULL, NULL, NULL, NULL);
INSERT INTO obs (robot, atom, positive, source, time_ns, expires_ns, since_ns, onset_ns, settled) VALUES ('r8', '["dec","odom_yaw"]', false, 'general', 1796086401999999991, 1796087402000000000, 1796086401900000000, 1796086401900000000, 3);
INSERT INTO obs (robot, atom, positive, source, time_ns, expires_ns, since_ns, onset_ns, settled) VALUES ('r8', '["const","odom_yaw"]', false, 'general', 1796086401999999991, 1796087402000000000, 1796086401900000000, 1796086401900000000, 3);
INSERT INTO obs (robot, atom, positive, source, time_ns, expires_ns, since_ns, onset_ns, settled) VALUES ('r8', '["inc","odom_yaw"]', true, 'general', 1796086403000000000, 1796087403000000000, 1796086402999999990, NULL, NULL);
INSERT INTO obs (robot, atom, positive, source, time_ns, expires_ns, since_ns, onset_ns, settled) VALUES ('r9', '["ok","map"]', true, 'general', 1796086402999999995, NULL, NULL, NULL, NULL);
INSERT INTO observations (number, robot, revision, time_ns, data) VALUES (4, 'r8', 1, 1796000000000000000, '{"b":"robot-r8","e":[["ok",["scan"],true,"general",1795999999999999995],["ok",["odom"],true,"general",1795999999999999995]]}');
INSERT INTO observations (number, robot, revision, time_ns, data) VALUES (5, 'r8', 2, 1796000001000000000, '{"b":"robot-r8","e":[["ok",["scan"],false,"general",1796000000999999995]]}');
INSERT INTO observations (number, robot, revision, time_ns, data) VALUES (6, 'r8', 3, 1796086401000000000, '{"b":"robot-r8","e":[["ok",["scan"],true,"general",1796086400999999995]]}');
INSERT INTO observations (number, robot, revision, time_ns, data) VALUES (7, 'r8', 4, 1796086401000000000, '{"b":"robot-r8","e":[["ok",["odom"],false,"general",1796086400999999995]]}');
INSERT INTO observations (number, robot, revision, time_ns, data) VALUES (8, 'r9', 1, 1796086401000000000, '{"b":"robot-r8","e":[["ok",["odom"],false,"general",1796086400999999995]]}');
INSERT INTO observations (number, robot, revision, time_ns, data) VALUES (9, 'r8', 5, 1796086401000000000, '{"b":"robot-r8","e":[["ok",["odom"],true,"general",1796086400999999995]]}');
INSERT INTO observations (number, robot, revision, time_ns, data) VALUES (10, 'r8', 6, 1796086402000000000, '{"b":"robot-r8","e":[["inc",["odom_yaw"],true,"general",1796086401999999991,1796087402000000000,1796086401900000000,1796086401900000000,3]]}');
INSERT INTO observations (number, robot, revision, time_ns, data) VALUES (11, 'r9', 2, 1796086403000000000, '{"b":"ada","e":[["ok",["map"],true,"general",1796086402999999995]],"a":[["night","ok(map) or ok(scan)","ada",1796086403000000000,null]]}');
INSERT INTO observations (number, robot, revision, time_ns, data) VALUES (12, 'r9', 3, 1796086404000000000, '{"b":"ada","e":[],"w":["night"]}');
INSERT INTO results (number, digest, used_day, data) VALUES (3, '\xaa8d2a13274acd363c2ee3ee6b56cf12', 20787, '\x789c358e490ec2301004ffd2679f38fa2b288abc4c8261e2b1ec714484f83b49806b7549d55824128f2bd59624c362bdc060729d15367766037a160a4a716c2aa55084bd0e0695dae9bc10939bb3346afbf0827787809b3cfa26d8c559e424773777570f52aa78e71327ddbe8df70e832c854909566b27835f6cf4dbff47903c710a7a74860f3aba40ba');
INSERT INTO results (number, digest, used_day, data) VALUES (4, '\x0227aa676ad022ff2a4248d9c26593f5', 20788, '\x789c5d8e490ac3301004ffd2679d72d45782315ac64666ac11d2c8c498fc3d76964baed505d55825128f1bd59624c362bbc160729d15367766037a140a4a716c2aa55084bd0f0695dadb3910939bb3346ae770c0bb4bc0e2e6ee2a4e7116f923a58a773e71d2fdd3789e30c85a989460b57632f8c646bfff7e04c913a7a0576778012d414095');
INSERT INTO results (number, digest, used_day, data) VALUES (2, '\xbcfbd1c9d2aaf651cdc453378e76e0ca', 20788, '\x789c358e4b0e83301043efe275565de62a1542f90c2868c844c90415a1debd40dba5ed273d6395483c6e545b920c8bed0183c97556d8dc990de8552828c5b1a9944211f63918546a37732026376769d4cee1807717802c997062b3c89d17377757afa654f1ce274eba7f0defb30cb216262558ad9d0c7eaad1efff1741f2c429e865193ea50e3fcb');
INSERT INTO results (number, digest, used_day, data) VALUES (6, '\x358dc9baff151e9c9f4b7f3008cf619e', 20788, '\x789c358e490ac3301004ffd2679d72d45782315ac64661ac11d2c8c498fc3d5e926b7541351689c4e34ab525c9b0581f30985c6785cd9dd980de8582521c9b4a2914619f8341a576393b6272739646ed187678770ae0145dc5e1cd221778b9b9dfa454f1ce274ebadd89cf01832c854909566b27835f6bf4dbff46903c710a7a66862fe5ab4027');
INSERT INTO robot_state (robot, revision, fence, owner) VALUES ('r8', 6, 0, NULL);
INSERT INTO robot_state (robot, revision, fence, owner) VALUES ('r9', 3, 0, NULL);
INSERT INTO robots (id, config, etag, model, created_ns, updated_ns) VALUES ('r8', '{"model":"tedusar"}', 'be3c798a21af630b8fdb', 'tedusar', 1796000000000000000, 1796000000000000000);
INSERT INTO robots (id, config, etag, model, created_ns, updated_ns) VALUES ('r9', '{"model":"tedusar"}', 'be3c798a21af630b8fdb', 'tedusar', 1796000000000000000, 1796000000000000000);
INSERT INTO start_ups (robot, topic, took) VALUES ('r8', 'scan', '[2000000000]');
SELECT setval('results_number_seq', 6);
UPDATE alembic_version SET version_num = '0008';
