CREATE TABLE batch_jobs (
    number bigint NOT NULL,
    id text NOT NULL COLLATE pg_catalog."C",
    place text NOT NULL COLLATE pg_catalog."C",
    state text NOT NULL COLLATE pg_catalog."C",
    open boolean NOT NULL,
    data text NOT NULL COLLATE pg_catalog."C",
    created_ns bigint NOT NULL,
    updated_ns bigint NOT NULL
);
CREATE SEQUENCE batch_jobs_number_seq
    START WITH 1
    INCREMENT BY 1
    NO MINVALUE
    NO MAXVALUE
    CACHE 1;
ALTER SEQUENCE batch_jobs_number_seq OWNED BY batch_jobs.number;
ALTER TABLE ONLY batch_jobs ALTER COLUMN number SET DEFAULT nextval('batch_jobs_number_seq'::regclass);
INSERT INTO batch_jobs VALUES (1, 'b-7k2m9x4q', '/var/lib/robomend/batches', 'waiting', true, '{"model":"tedusar","source":"upload","files":["night.bag"],"by":"local"}', 1795409102806262425, 1795409102806262425);
SELECT pg_catalog.setval('batch_jobs_number_seq', 1, true);
ALTER TABLE ONLY batch_jobs
    ADD CONSTRAINT batch_jobs_id_key UNIQUE (id);
ALTER TABLE ONLY batch_jobs
    ADD CONSTRAINT batch_jobs_pkey PRIMARY KEY (number);
CREATE INDEX ix_batch_jobs_open ON batch_jobs USING btree (place) WHERE open;
UPDATE alembic_version SET version_num = '0007';
