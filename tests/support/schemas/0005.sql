BEGIN TRANSACTION;
CREATE TABLE alembic_version (
	version_num VARCHAR(32) NOT NULL, 
	CONSTRAINT alembic_version_pkc PRIMARY KEY (version_num)
);
INSERT INTO "alembic_version" VALUES('0005');
CREATE TABLE api_keys (
	id VARCHAR(40) NOT NULL, 
	name VARCHAR(200) NOT NULL, 
	scope VARCHAR(20) NOT NULL, 
	secret_hash VARCHAR(200) NOT NULL, 
	created_at DATETIME NOT NULL, 
	created_by VARCHAR(200) NOT NULL, 
	expires_at DATETIME, 
	revoked_at DATETIME, 
	used_at DATETIME, used_from VARCHAR(60) DEFAULT '' NOT NULL, 
	PRIMARY KEY (id)
);
INSERT INTO "api_keys" VALUES('key_1','laptop','admin','0000000000000000000000000000000000000000000000000000000000000000','2026-01-02 03:04:05.678901','local',NULL,NULL,'2026-01-02 03:04:05.678901','');
CREATE TABLE audit (
	id VARCHAR(40) NOT NULL, 
	at DATETIME NOT NULL, 
	who VARCHAR(200) NOT NULL, 
	key_id VARCHAR(40) NOT NULL, 
	action VARCHAR(60) NOT NULL, 
	rig_id VARCHAR(40), 
	resource VARCHAR(80) NOT NULL, 
	detail JSON NOT NULL, 
	request_id VARCHAR(80) NOT NULL, 
	PRIMARY KEY (id)
);
INSERT INTO "audit" VALUES('aud_1','2026-01-02 03:04:05.678901','x','key_1','rig.created','rig_1','rig_1','{}','r');
CREATE TABLE experiments (
	id VARCHAR(40) NOT NULL, 
	rig_id VARCHAR(40) NOT NULL, 
	rig_version INTEGER NOT NULL, 
	job_id VARCHAR(40), 
	source VARCHAR(20) NOT NULL, 
	purpose VARCHAR(20) NOT NULL, 
	complete BOOLEAN NOT NULL, 
	file_sha256 VARCHAR(64) NOT NULL, 
	file_bytes INTEGER NOT NULL, 
	media_type VARCHAR(80) NOT NULL, 
	file_name VARCHAR(200) NOT NULL, 
	summary JSON NOT NULL, 
	created_at DATETIME NOT NULL, 
	created_by VARCHAR(200) NOT NULL, 
	PRIMARY KEY (id), 
	FOREIGN KEY(rig_id) REFERENCES rigs (id)
);
INSERT INTO "experiments" VALUES('exp_1','rig_1',1,NULL,'uploaded','commissioning',1,'aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa',5,'application/x-hdf5','a.h5','{"axes": ["xA"]}','2026-01-02 03:04:05.678901','x');
CREATE TABLE gaps (
	id VARCHAR(40) NOT NULL, 
	rig_id VARCHAR(40) NOT NULL, 
	rig_version INTEGER NOT NULL, 
	experiment_id VARCHAR(40) NOT NULL, 
	job_id VARCHAR(40), 
	gap_sha256 VARCHAR(64) NOT NULL, 
	report_sha256 VARCHAR(64) NOT NULL, 
	summary JSON NOT NULL, 
	created_at DATETIME NOT NULL, 
	created_by VARCHAR(200) NOT NULL, 
	PRIMARY KEY (id), 
	FOREIGN KEY(experiment_id) REFERENCES experiments (id), 
	FOREIGN KEY(rig_id) REFERENCES rigs (id)
);
CREATE TABLE health_checks (
	id VARCHAR(40) NOT NULL, 
	rig_id VARCHAR(40) NOT NULL, 
	rig_version INTEGER NOT NULL, 
	experiment_id VARCHAR(40) NOT NULL, 
	model_id VARCHAR(40) NOT NULL, 
	schedule_id VARCHAR(40), 
	job_id VARCHAR(40), 
	document JSON NOT NULL, 
	report_sha256 VARCHAR(64) NOT NULL, 
	alarm BOOLEAN NOT NULL, 
	created_at DATETIME NOT NULL, 
	PRIMARY KEY (id), 
	FOREIGN KEY(experiment_id) REFERENCES experiments (id), 
	FOREIGN KEY(model_id) REFERENCES models (id), 
	FOREIGN KEY(rig_id) REFERENCES rigs (id)
);
CREATE TABLE idempotency (
	owner VARCHAR(40) NOT NULL, 
	"key" VARCHAR(255) NOT NULL, 
	request_sha256 VARCHAR(64) NOT NULL, 
	status INTEGER NOT NULL, 
	location TEXT NOT NULL, 
	body JSON NOT NULL, 
	created_at DATETIME NOT NULL, 
	PRIMARY KEY (owner, "key")
);
CREATE TABLE jobs (
	id VARCHAR(40) NOT NULL, 
	kind VARCHAR(20) NOT NULL, 
	rig_id VARCHAR(40) NOT NULL, 
	rig_version INTEGER NOT NULL, 
	experiment_id VARCHAR(40), 
	schedule_id VARCHAR(40), 
	options JSON NOT NULL, 
	priority INTEGER NOT NULL, 
	state VARCHAR(20) NOT NULL, 
	submitted_by VARCHAR(200) NOT NULL, 
	created_at DATETIME NOT NULL, 
	started_at DATETIME, 
	ended_at DATETIME, 
	run INTEGER NOT NULL, 
	dispatched_run INTEGER NOT NULL, 
	attempt INTEGER NOT NULL, 
	worker VARCHAR(200) NOT NULL, 
	cancel_requested BOOLEAN NOT NULL, 
	changes INTEGER NOT NULL, 
	percent FLOAT NOT NULL, 
	point INTEGER NOT NULL, 
	points INTEGER NOT NULL, 
	phase TEXT NOT NULL, 
	time_left_s DOUBLE, 
	result JSON NOT NULL, 
	error_title TEXT NOT NULL, 
	error_detail TEXT NOT NULL, requested_by VARCHAR(200) DEFAULT '' NOT NULL, requested_key VARCHAR(40) DEFAULT '' NOT NULL, 
	PRIMARY KEY (id), 
	FOREIGN KEY(rig_id) REFERENCES rigs (id)
);
INSERT INTO "jobs" VALUES('job_1','experiment','rig_1',1,NULL,NULL,'{"profile": "quick"}',5,'done','x','2026-01-02 03:04:05.678901',NULL,NULL,1,1,1,'w1',0,7,100.0,9,9,'done',NULL,'{"model": "mod_1"}','','','x','');
CREATE TABLE journal_parts (
	job_id VARCHAR(40) NOT NULL, 
	"offset" INTEGER NOT NULL, 
	content BLOB NOT NULL, 
	PRIMARY KEY (job_id, "offset"), 
	FOREIGN KEY(job_id) REFERENCES jobs (id)
);
INSERT INTO "journal_parts" VALUES('job_1',0,X'00010203040506070809');
CREATE TABLE models (
	id VARCHAR(40) NOT NULL, 
	rig_id VARCHAR(40) NOT NULL, 
	rig_version INTEGER NOT NULL, 
	experiment_id VARCHAR(40) NOT NULL, 
	job_id VARCHAR(40), 
	result_sha256 VARCHAR(64) NOT NULL, 
	report_sha256 VARCHAR(64) NOT NULL, 
	plots_sha256 VARCHAR(64) NOT NULL, 
	summary JSON NOT NULL, 
	created_at DATETIME NOT NULL, 
	created_by VARCHAR(200) NOT NULL, 
	PRIMARY KEY (id), 
	FOREIGN KEY(experiment_id) REFERENCES experiments (id), 
	FOREIGN KEY(rig_id) REFERENCES rigs (id)
);
INSERT INTO "models" VALUES('mod_1','rig_1',1,'exp_1',NULL,'bbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbbb','cccccccccccccccccccccccccccccccccccccccccccccccccccccccccccccccc','dddddddddddddddddddddddddddddddddddddddddddddddddddddddddddddddd','{"planes": {}}','2026-01-02 03:04:05.678901','x');
CREATE TABLE rig_versions (
	rig_id VARCHAR(40) NOT NULL, 
	version INTEGER NOT NULL, 
	datasheet TEXT NOT NULL, 
	controller_url TEXT NOT NULL, 
	note TEXT NOT NULL, 
	created_at DATETIME NOT NULL, 
	created_by VARCHAR(200) NOT NULL, 
	PRIMARY KEY (rig_id, version), 
	FOREIGN KEY(rig_id) REFERENCES rigs (id)
);
INSERT INTO "rig_versions" VALUES('rig_1',1,'[rig]
name = ''x;y''
','modbus://h','','2026-01-02 03:04:05.678901','x');
CREATE TABLE rigs (
	id VARCHAR(40) NOT NULL, 
	name VARCHAR(200) NOT NULL, 
	version INTEGER NOT NULL, 
	created_at DATETIME NOT NULL, 
	updated_at DATETIME NOT NULL, 
	retired_at DATETIME, 
	baseline_model_id VARCHAR(40), 
	PRIMARY KEY (id), 
	UNIQUE (name)
);
INSERT INTO "rigs" VALUES('rig_1','bench äöü',1,'2026-01-02 03:04:05.678901','2026-01-02 03:04:05.678901',NULL,NULL);
CREATE TABLE schedule_runs (
	schedule_id VARCHAR(40) NOT NULL, 
	due_at DATETIME NOT NULL, 
	state VARCHAR(20) NOT NULL, 
	detail TEXT NOT NULL, 
	job_id VARCHAR(40), 
	recorded_at DATETIME NOT NULL, 
	PRIMARY KEY (schedule_id, due_at), 
	FOREIGN KEY(schedule_id) REFERENCES schedules (id)
);
CREATE TABLE schedules (
	id VARCHAR(40) NOT NULL, 
	rig_id VARCHAR(40) NOT NULL, 
	cron VARCHAR(100) NOT NULL, 
	timezone VARCHAR(60) NOT NULL, 
	options JSON NOT NULL, 
	enabled BOOLEAN NOT NULL, 
	webhook_url TEXT NOT NULL, 
	webhook_secret TEXT NOT NULL, 
	webhook_on VARCHAR(10) NOT NULL, 
	next_at DATETIME, 
	created_at DATETIME NOT NULL, 
	updated_at DATETIME NOT NULL, 
	created_by VARCHAR(200) NOT NULL, 
	deleted_at DATETIME, 
	PRIMARY KEY (id), 
	FOREIGN KEY(rig_id) REFERENCES rigs (id)
);
INSERT INTO "schedules" VALUES('sch_1','rig_1','0 6 * * *','UTC','{}',1,'https://plant.example/hook','whsec_AAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAA','alarm',NULL,'2026-01-02 03:04:05.678901','2026-01-02 03:04:05.678901','x',NULL);
CREATE TABLE webhook_deliveries (
	id VARCHAR(40) NOT NULL, 
	schedule_id VARCHAR(40) NOT NULL, 
	health_id VARCHAR(40) NOT NULL, 
	url TEXT NOT NULL, 
	state VARCHAR(20) NOT NULL, 
	attempts INTEGER NOT NULL, 
	status_code INTEGER, 
	detail TEXT NOT NULL, 
	created_at DATETIME NOT NULL, 
	updated_at DATETIME NOT NULL, contents JSON DEFAULT '{}' NOT NULL, dispatched BOOLEAN DEFAULT 1 NOT NULL, next_at DATETIME, 
	PRIMARY KEY (id), 
	FOREIGN KEY(schedule_id) REFERENCES schedules (id)
);
INSERT INTO "webhook_deliveries" VALUES('whd_1','sch_1','','https://plant.example/hook','pending',3,503,'','2026-01-02 03:04:05.678901','2026-01-02 03:04:05.678901','{"type": "health.missed"}',0,'2026-01-02 03:04:05.678901');
INSERT INTO "webhook_deliveries" VALUES('whd_2','sch_1','','https://plant.example/hook','delivered',1,204,'','2026-01-02 03:04:05.678901','2026-01-02 03:04:05.678901','{"type": "health.missed"}',1,NULL);
CREATE TABLE workers (
	name VARCHAR(200) NOT NULL, 
	instance VARCHAR(40) NOT NULL, 
	machine VARCHAR(200) NOT NULL, 
	process INTEGER NOT NULL, 
	started_at DATETIME NOT NULL, 
	beat_at DATETIME NOT NULL, 
	stopped_at DATETIME, 
	PRIMARY KEY (name)
);
CREATE INDEX ix_audit_action ON audit (action);
CREATE INDEX ix_audit_rig_id ON audit (rig_id);
CREATE INDEX ix_idempotency_created_at ON idempotency (created_at);
CREATE INDEX ix_experiments_job_id ON experiments (job_id);
CREATE INDEX ix_experiments_rig_id ON experiments (rig_id);
CREATE INDEX ix_jobs_experiment_id ON jobs (experiment_id);
CREATE INDEX ix_jobs_kind ON jobs (kind);
CREATE INDEX ix_jobs_rig_id_id ON jobs (rig_id, id);
CREATE INDEX ix_jobs_state_id ON jobs (state, id);
CREATE INDEX ix_schedules_next_at ON schedules (next_at);
CREATE INDEX ix_schedules_rig_id ON schedules (rig_id);
CREATE INDEX ix_gaps_experiment_id ON gaps (experiment_id);
CREATE INDEX ix_gaps_job_id ON gaps (job_id);
CREATE INDEX ix_gaps_rig_id ON gaps (rig_id);
CREATE INDEX ix_models_experiment_id ON models (experiment_id);
CREATE INDEX ix_models_job_id ON models (job_id);
CREATE INDEX ix_models_rig_id ON models (rig_id);
CREATE INDEX ix_webhook_deliveries_health_id ON webhook_deliveries (health_id);
CREATE INDEX ix_webhook_deliveries_schedule_id ON webhook_deliveries (schedule_id);
CREATE INDEX ix_health_checks_alarm ON health_checks (alarm);
CREATE INDEX ix_health_checks_experiment_id ON health_checks (experiment_id);
CREATE INDEX ix_health_checks_job_id ON health_checks (job_id);
CREATE INDEX ix_health_checks_model_id ON health_checks (model_id);
CREATE INDEX ix_health_checks_rig_id ON health_checks (rig_id);
CREATE INDEX ix_health_checks_schedule_id ON health_checks (schedule_id);
CREATE INDEX ix_webhook_deliveries_next_at ON webhook_deliveries (next_at);
COMMIT;
