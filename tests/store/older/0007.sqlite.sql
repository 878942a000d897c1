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
CREATE INDEX ix_batch_jobs_open ON batch_jobs (place) WHERE open;
UPDATE alembic_version SET version_num = '0007';
